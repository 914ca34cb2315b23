"""The two kinds of contestants: mcvr, a process for each turn, and peers, a worker; both keep the volume from view to view."""
import json
import os
import subprocess
import sys
import threading

import numpy as np

from worker import Export, Refused, relative_rmse

HERE = os.path.dirname(os.path.abspath(__file__))


class Mcvr:
    """One method of mcvr with its setting. A view is the last of a few further images of a process, which keep the weights and the map of
    empty bricks as a peer's worker keeps its volume and what it has made of it; its time is the one that the program itself took,
    from there to linear pixels. The first image's time, with those made, is noted beside it."""

    # Further images of a process; the last one counts.
    repeats = 4

    own_field = None

    def __init__(self, run, system, setting, args):
        self.run, self.system, self.setting, self.args = run, system, setting, args
        self.version, self.threads = run.version, run.threads

    def view(self, seed):
        out = os.path.join(self.run.scratch, "view.npy")
        command = [self.run.program, "render", *self.run.scan, *self.args, "--seed", str(seed), "--threads", str(self.threads)]
        command += ["--repeats", str(self.repeats), "--quiet", "--json", "-", "-o", out]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            said = done.stderr.strip().splitlines()
            raise Refused(said[0] if said else f"exit status {done.returncode}")
        record = json.loads(done.stdout)
        repeats = record["seconds"]["repeats"]
        image = np.load(out).astype(np.float64)
        first = record["seconds"]["complete"]
        took = {"seconds": repeats["complete"][-1], "cpu": repeats["cpu"][-1], "first": first}
        error, centre = (relative_rmse(image, self.run.truths[name]) for name in ("area", "centre-tent"))
        # Some methods take means over pixels, and some cast the rays through their centres: the nearer one is its own.
        return took, {"error": error, "own_error": min(error, centre), "chosen": record["method"]}


class Worker:
    """A peer's process for one scan and one number of threads."""

    def __init__(self, run, script, environment, patience):
        self.run, self.patience = run, patience
        self.process = subprocess.Popen(
            [sys.executable, os.path.join(HERE, script), run.folder, str(run.threads)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, **environment},
        )
        self.about = self.answer(600)
        self.own_field = f"centre-{self.about['field']}"

    def answer(self, seconds):
        """The next line; a worker that gives none in time is ended."""
        timer = threading.Timer(seconds, self.process.kill)
        timer.start()
        line = self.process.stdout.readline()
        timer.cancel()
        if not line:
            raise Refused(f"the worker ended or gave no answer in {seconds} s")
        answer = json.loads(line)
        if "refused" in answer:
            raise Refused(answer["refused"])
        return answer

    def settings(self):
        """Its settings as contestants."""
        return [Peer(self, about) for about in self.about["settings"]]

    def close(self):
        """Ends the process."""
        self.process.stdin.close()
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()


class Peer:
    """One setting of a peer."""

    def __init__(self, worker, about):
        self.worker, self.rays, self.setting = worker, about["rays"], about["name"]
        self.system, self.version, self.threads = worker.about["system"], worker.about["version"], worker.run.threads
        self.own_field = worker.own_field

    def view(self, _seed):
        out = os.path.join(self.worker.run.scratch, "view.npy")
        self.worker.process.stdin.write(json.dumps({"setting": self.setting, "output": out}) + "\n")
        self.worker.process.stdin.flush()
        took = self.worker.answer(self.worker.patience)
        image, truths = np.load(out), self.worker.run.truths
        # Its own field is known along the rays through the pixels' centres only.
        own = relative_rmse(image, truths[self.own_field]) if self.rays == 1 else None
        return took, {"error": relative_rmse(image, truths["area"]), "own_error": own}


class Run:
    """A scan exported, on a number of threads."""

    def __init__(self, program, scan, folder, threads, scratch):
        self.program, self.scan, self.folder, self.threads, self.scratch = program, scan, folder, threads, scratch
        self.export = Export(folder)
        self.truths = {name: self.export.image(name) for name in ("area", "centre-tent", "centre-box")}
        versions = self.export.description["versions"]
        self.version = f"{versions['mcvr']} ({versions['commit']})"
