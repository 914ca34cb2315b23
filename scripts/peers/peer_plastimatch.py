"""plastimatch drr on the CPU (Debian package plastimatch): `exact` is Siddon's integral through box voxels, `uniform` samples the
trilinear field.

It is a program that loads, renders and ends, so that a view alone is its own figure: the log's "Total time" less its
"I/O time". The processor seconds of a view are those of a run less those of a run that renders 2 x 2 pixels.
"""
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile

import numpy as np

from worker import Refused, cpu_seconds, pooled, serve

RAYS = (1, 2, 3)


def start(export, threads):
    if not shutil.which("plastimatch"):
        raise Refused("plastimatch is not installed: apt-get install plastimatch")
    export.check_axes("plastimatch drr")
    export.check_upright()
    export.check_centred("plastimatch drr")
    scratch = tempfile.TemporaryDirectory(prefix="plastimatch-")
    isocentre = export.source - export.normal * export.source_centre

    def run(algorithm, size):
        for name in os.listdir(scratch.name):
            os.remove(os.path.join(scratch.name, name))
        sides = [export.height * export.pitch[1], export.width * export.pitch[0]]
        numbers = lambda values: " ".join(repr(float(v)) for v in values)
        command = ["plastimatch", "drr", "-A", "cpu", "-i", algorithm, "-P", "none", "-t", "pfm"]
        command += ["-r", "{} {}".format(*size), "-z", numbers(sides), "-o", numbers(isocentre)]
        command += ["--sad", repr(export.source_centre), "--sid", repr(export.source_detector)]
        command += ["-n", numbers(export.normal), "--vup", numbers(-export.row)]
        command += ["-I", export.path, "-O", os.path.join(scratch.name, "out")]
        before = cpu_seconds()
        done = subprocess.run(command, env={**os.environ, "OMP_NUM_THREADS": str(threads)}, capture_output=True, text=True)
        if done.returncode:
            raise Refused(f"plastimatch drr failed: {(done.stdout + done.stderr)[-300:]}")
        return done.stdout, cpu_seconds() - before

    loading = statistics.median(run("exact", [2, 2])[1] for _ in range(3))

    def view(algorithm, rays):
        log, cpu = run(algorithm, [export.height * rays, export.width * rays])
        total, files = (float(re.search(name + r": ([0-9.eE+-]+)", log).group(1)) for name in ("Total time", "I/O time"))
        made = [name for name in os.listdir(scratch.name) if name.endswith(".pfm")]
        if len(made) != 1:
            raise Refused(f"plastimatch drr wrote {made} instead of one image")
        # plastimatch integrates over centimetres.
        image = 10.0 * read_pfm(os.path.join(scratch.name, made[0]))
        return pooled(image, rays), {"seconds": total - files, "cpu": max(cpu - loading, 0.0)}

    def settings(algorithm, choices):
        name = lambda rays: f"{rays}x{rays} rays"
        return [{"name": name(r), "rays": r, "render": lambda r=r: view(algorithm, r)} for r in choices]

    algorithm = os.environ.get("PLASTIMATCH_ALGORITHM", "exact")
    return {
        "system": f"plastimatch {algorithm}",
        "version": subprocess.run(["plastimatch", "--version"], capture_output=True, text=True).stdout.split()[-1],
        "field": "box" if algorithm == "exact" else "tent",
        "settings": settings(algorithm, RAYS),
        "scratch": scratch,
    }


def read_pfm(path):
    """A grey PFM image as plastimatch writes it: rows from the top, unlike the format's rule."""
    with open(path, "rb") as file:
        if file.readline().strip() != b"Pf":
            raise Refused(f"{path} is no grey PFM image")
        width, height = map(int, file.readline().split())
        kind = "<f4" if float(file.readline()) < 0 else ">f4"
        return np.frombuffer(file.read(), kind, width * height).reshape(height, width).astype(np.float64)


if __name__ == "__main__":
    sys.exit(serve(start))
