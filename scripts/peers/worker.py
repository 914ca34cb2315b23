"""What all peers share: the exported scan, and a loop that renders a view for every line on standard input.

A worker is started as `python peer_NAME.py FOLDER THREADS`, where FOLDER is what `mcvr export --truth` wrote. It loads the
volume once and says so in one JSON line: {"system", "version", "field", "settings"}. Then it reads requests, one JSON object a
line, {"setting": NAME, "output": FILE or null}, and answers each with {"seconds", "cpu"}: wall-clock and processor seconds of one
view, from the volume in memory to the image in memory. The image, where it is asked for, is (rows, columns), float64, row 0 at
the top, in weight units times mm.
"""
import json
import os
import resource
import sys
import time

import numpy as np


class Refused(Exception):
    """This peer cannot show this scan or this camera; the message says why."""


class Export:
    """The folder of `mcvr export`: see the help of that command for the files."""

    def __init__(self, folder):
        self.folder = folder
        with open(os.path.join(folder, "geometry.json"), encoding="utf-8") as file:
            self.description = json.load(file)
        if self.description.get("format_version") != 1:
            raise Refused(f"{folder}/geometry.json: format_version 1 is needed; export the scan again")
        camera, volume = self.description["camera"], self.description["volume"]
        self.path = os.path.join(folder, volume["file"])
        vector = lambda name: np.array(camera[name], float)
        self.source, self.centre = vector("source_mm"), vector("detector_centre_mm")
        self.column, self.row = vector("column_axis"), vector("row_axis")
        self.pitch, self.width, self.height = camera["pixel_pitch_mm"], *camera["size"]
        self.source_detector, self.source_centre = camera["source_detector_mm"], camera["source_centre_mm"]
        self.principal = camera["principal_point_px"]
        self.dims, self.spacing, self.origin = volume["dims"], volume["spacing"], volume["origin"]
        self.direction = np.array(volume["direction"], float)
        # Away from the scan, towards the source.
        self.normal = np.cross(self.column, -self.row)

    def check_axes(self, who):
        """Refuses a grid that is turned against the world, for peers that may leave the direction aside."""
        if not np.allclose(self.direction, np.eye(3), atol=1e-9):
            raise Refused(f"{who} is used for grids along the world's axes only, and this one is turned")

    def check_upright(self):
        """Refuses a mirrored camera."""
        if np.dot(self.normal, self.source - self.centre) <= 0:
            raise Refused("the camera is mirrored")

    def check_centred(self, who):
        """Refuses a source that is not in front of the detector's middle."""
        away = max(abs(self.principal[0] - self.width / 2), abs(self.principal[1] - self.height / 2))
        if away > 1e-6:
            raise Refused(f"{who}: the principal point is {away} pixels from the image's middle")

    def image(self, name):
        """One of the truths, float64: `area`, `centre-tent` or `centre-box`."""
        entry = self.description["truth"].get(name)
        if entry is None:
            raise Refused(f"{self.folder}: the export has no truth; export again with --truth")
        return np.load(os.path.join(self.folder, entry["file"])).astype(np.float64)


def relative_rmse(image, truth):
    """Root mean square difference over the truth's mean pixel, as mcvr counts errors."""
    return float(np.sqrt(np.mean((image - truth) ** 2)) / np.mean(truth))


def pooled(image, rays):
    """Means over blocks of rays x rays pixels."""
    rows, columns = image.shape[0] // rays, image.shape[1] // rays
    return image.reshape(rows, rays, columns, rays).mean((1, 3))


def cpu_seconds():
    """Processor seconds of this process and of its finished children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def timed(make):
    """The image and the seconds that making it took."""
    wall, cpu = time.perf_counter(), cpu_seconds()
    image = make()
    return image, {"seconds": time.perf_counter() - wall, "cpu": cpu_seconds() - cpu}


def serve(start):
    """Runs a worker. `start(export, threads)` gives a dictionary with system, version, field ("tent" or "box") and settings;
    each setting has a name and `render`, which gives (image, seconds), and may have others that describe it."""
    # Libraries print what they like; answers go to the descriptor that was standard output.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def say(value):
        answers.write(json.dumps(value) + "\n")
        answers.flush()

    if len(sys.argv) != 3:
        sys.exit(f"usage: python {os.path.basename(sys.argv[0])} FOLDER THREADS")
    try:
        peer = start(Export(sys.argv[1]), int(sys.argv[2]))
    except (Refused, ImportError) as problem:
        say({"refused": f"{type(problem).__name__}: {problem}"})
        return
    settings = {s["name"]: s for s in peer["settings"]}
    described = [{k: v for k, v in s.items() if k != "render"} for s in peer["settings"]]
    say({**{k: peer[k] for k in ("system", "version", "field")}, "settings": described})
    for line in sys.stdin:
        request = json.loads(line)
        try:
            image, took = settings[request["setting"]]["render"]()
        except Refused as problem:
            say({"refused": str(problem)})
            continue
        if request.get("output"):
            np.save(request["output"], np.asarray(image, np.float64))
        say(took)
