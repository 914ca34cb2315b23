"""What is compared: scans with their views, mcvr's ways to an error, and the peers. Add lines here."""
import math

# The peers' phantom is seen from 1000 mm on a detector of 440 mm at 1500 mm.
PHANTOM_VIEW = ["--distance", "1000", "--fov", repr(2 * math.degrees(math.atan(220 / 1500)))]


def raw(name, dims, kind, spacing, *more):
    """A file of the folder of scans."""
    return {"file": name, "args": ["--dims", dims, "--type", kind, "--spacing", spacing, *more]}


SCANS = {
    "lobster": raw("lobster_301x324x56_uint8.raw.gz", "301,324,56", "u8", "1,1,1.4"),
    "cthead": raw("cthead_256x256x113_uint16be.raw.gz", "256,256,113", "u16", "1,1,2", "--endian", "be"),
    "chest": raw(
        "chest_ct_hu_256x256x137_int16le.raw.gz", "256,256,137", "i16", "1.5625,1.5625,2", "--endian", "le", "--map", "hounsfield"
    ),
    "aneurism": raw("aneurism_256x256x256_uint8.raw.gz", "256,256,256", "u8", "1,1,1"),
    "statue": raw("statue_leg_341x341x93_uint8.raw.gz", "341,341,93", "u8", "1,1,4"),
    "stent": raw("stent_128x128x256_int16le.raw.gz", "128,128,256", "i16", "1,1,1", "--endian", "le"),
    "phantom256": {"phantom": 256, "args": [*PHANTOM_VIEW, "--size", "400x400"]},
    "phantom512": {"phantom": 512, "args": [*PHANTOM_VIEW, "--size", "512x512"]},
}


def ladder(name, args, option, values):
    """A method whose error falls with a number: the values are tried, and what an error needs is read off between them."""
    return {"name": name, "args": args, "option": option, "values": values}


def setting(name, *args):
    """A method as it stands. Settings whose names are the same up to a comma go from coarse to fine."""
    return {"name": name, "args": list(args)}


# Single methods: the quickest of them that reaches an error is "best single method". Samplers are continuous.
SINGLE = [
    ladder("qmc", ["--method", "qmc"], "--samples", [1 << k for k in range(16, 31, 2)]),
    setting("march step 1, 1 rays", "--method", "march", "--step", "1", "--rays-a-pixel", "1"),
    *(
        setting(f"comb step {step}, {rays} rays", "--method", "comb", "--step", str(step), "--rays-a-pixel", str(rays))
        for rays in (0.25, 1, 4)
        for step in (4, 2, 1)
    ),
    *(
        setting(f"adaptive comb step {step}, leaving {left}", "--method", "comb", "--step", str(step), "--adaptive", left)
        for step in (5, 3, 2, 1)
        for left in ("7%", "2%", "0.7%", "0.2%")
    ),
    setting("footprint", "--method", "footprint"),
    *(setting(f"rays, {rays}", "--method", "rays", "--rays-a-pixel", str(rays)) for rays in (1, 4, 9)),
]

# The program's own choice, for each error.
AUTO = ["--method", "auto", "--error", "{percent}%"]

# Workers: name, file, environment.
PEERS = [
    ("RTK", "peer_rtk.py", {}),
    ("plastimatch", "peer_plastimatch.py", {"PLASTIMATCH_ALGORITHM": "exact"}),
    ("VTK fixed", "peer_vtk.py", {"VTK_MAPPER": "fixed"}),
    ("VTK llvmpipe", "peer_vtk.py", {"VTK_MAPPER": "gpu"}),
]
