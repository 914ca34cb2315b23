"""Measures mcvr and its peers on the same scans, views and threads, one view after the other in turn.

    python compare.py --mcvr target/release/mcvr --scans FOLDER --work FOLDER -o peers.jsonl

For each scan: `mcvr export --truth`, then each system's settings once; of each system the settings that may be the quickest way
to one of the errors are then measured in rounds, every contestant once a round and the first one a different one each time, so
that a change of the machine's pace hits all alike. Each finished number of threads of a scan is appended to the record; what the
record holds already is not measured again. `python table.py peers.jsonl` makes the tables.
"""
import argparse
import datetime
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile

import cases
import phantom
from contestants import Mcvr, Run, Worker
from worker import Refused

# The form of the record's lines; `mcvr cost --peers` reads this one.
RECORD = "mcvr peers 1"
# Samplers' budgets are chosen for so much of the error, since the error differs from seed to seed.
MARGIN = 0.95
PLAIN = ("1x1 rays", "step 1, 1x1 rays", "step 1, a ray for 1x1 pixels")
# Settings of a system that are measured in rounds for each error: so many, none more than twice as slow as the first.
PER_TARGET = 2


def say(text):
    print(text, file=sys.stderr, flush=True)


def machine():
    """Processor and cores in words."""
    with open("/proc/cpuinfo", encoding="utf-8") as file:
        names = [line.split(":", 1)[1].strip() for line in file if line.startswith("model name")]
    return f"{names[0] if names else 'unknown processor'}, {len(os.sched_getaffinity(0))} cores"


def scan_args(name, options):
    """The arguments that name a scan and its view; phantoms are made on the way."""
    case = cases.SCANS[name]
    if "phantom" not in case:
        return [os.path.join(options.scans, case["file"]), *case["args"]]
    path = os.path.join(options.work, f"{name}.mha")
    if not os.path.exists(path):
        say(f"{name}: making the phantom")
        phantom.write(case["phantom"], path + ".part")
        os.replace(path + ".part", path)
    return [path, *case["args"]]


def export(name, scan, options):
    """The folder of the scan's export, made anew when the scan, the view or the program has changed."""
    folder = os.path.join(options.work, name)
    stamp = {"args": scan, "mcvr": os.stat(options.mcvr).st_mtime if options.fresh else None}
    noted = os.path.join(folder, "exported.json")
    if os.path.exists(noted) and os.path.exists(os.path.join(folder, "geometry.json")):
        with open(noted, encoding="utf-8") as file:
            if json.load(file) == stamp:
                return folder
    say(f"{name}: exporting, and casting the truth")
    subprocess.run([options.mcvr, "export", *scan, "--truth", "--quiet", "-o", folder], check=True)
    with open(noted, "w", encoding="utf-8") as file:
        json.dump(stamp, file)
    return folder


class Measured:
    """A contestant and what is known of it."""

    def __init__(self, contestant, group):
        self.contestant, self.group = contestant, group
        self.took, self.found = [], []

    def measure(self, seed):
        took, found = self.contestant.view(seed)
        self.took.append(took)
        self.found.append(found)

    def median(self, clock):
        return statistics.median(t[clock] for t in self.took)

    def rms(self, key):
        values = [f[key] for f in self.found if f.get(key) is not None]
        return math.sqrt(sum(v * v for v in values) / len(values)) if values else None

    def record(self, run, rounds):
        c = self.contestant
        spread = lambda clock: {
            "median": self.median(clock),
            "min": min(t[clock] for t in self.took),
            "max": max(t[clock] for t in self.took),
            "all": [t[clock] for t in self.took],
        }
        return {
            "record": RECORD,
            "subject": run.export.description["subject"],
            "group": self.group,
            "system": c.system,
            "version": c.version,
            "setting": c.setting,
            "threads": c.threads,
            "seconds": spread("seconds"),
            "cpu": spread("cpu"),
            "views": len(self.took),
            "in_rounds": rounds,
            "error": self.rms("error"),
            "own_error": self.rms("own_error"),
            "own_field": c.own_field,
            "truth_error": run.export.description["truth"]["area"]["rel_error_estimate"],
            "chosen": self.found[-1].get("chosen"),
            "machine": machine(),
            "when": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        }


def tried(measured, options):
    """Makes one view; None where the contestant refuses."""
    c = measured.contestant
    try:
        measured.measure(1)
    except Refused as why:
        say(f"  {c.system}, {c.setting}: left out: {why}")
        return None
    shown = f"error {100 * measured.rms('error'):.3g} %, {measured.median(options.clock):.4g} s"
    say(f"  {c.system}, {c.setting}: {shown}")
    return measured


def enough(measured, options):
    """Whether finer settings of the same kind are not worth trying: it takes too long, or is good enough for all errors."""
    return measured.median(options.clock) > options.longest or measured.rms("error") <= min(options.errors)


def singles(run, options):
    """mcvr's single methods, tried. Between two budgets of a sampler error and budget follow power laws."""
    found, ended = [], set()
    pixels = run.export.width * run.export.height
    for case in cases.SINGLE:
        make = lambda name, args: Measured(Mcvr(run, f"mcvr {case['name'].split(',')[0].split()[0]}", name, args), "mcvr single")
        if "values" not in case:
            family = case["name"].split(",")[0]
            if family in ended:
                continue
            args = list(case["args"])
            if "--rays-a-pixel" in args:
                at = args.index("--rays-a-pixel")
                args[at:] = ["--samples", str(math.ceil(float(args[at + 1]) * pixels))]
            found.append(tried(make(case["name"], args), options))
            if found[-1] is None or enough(found[-1], options):
                ended.add(family)
            continue
        at = lambda value: tried(make(f"{case['name']} {value}", [*case["args"], case["option"], str(value)]), options)
        steps = []
        for value in case["values"]:
            step = at(value)
            if step is None:
                break
            steps.append((value, step))
            found.append(step)
            if enough(step, options):
                break
        for target in options.errors:
            for (low, a), (high, b) in zip(steps, steps[1:]):
                before, after = a.rms("error"), b.rms("error")
                aim = MARGIN * target
                if after <= aim < before:
                    share = math.log(before / aim) / math.log(before / after)
                    found.append(at(math.ceil(low * (high / low) ** share)))
                    break
    return [f for f in found if f]


def autos(run, options):
    """mcvr's own choice for each error."""
    found = []
    for target in options.errors:
        percent = f"{100 * target:g}"
        args = [a.replace("{percent}", percent) for a in cases.AUTO]
        found.append(tried(Measured(Mcvr(run, "mcvr auto", f"{percent} %", args), "mcvr auto"), options))
    return [f for f in found if f]


def peers(run, options):
    """The peers that are installed and willing, tried, and their workers."""
    workers, found = [], []
    for name, script, environment in cases.PEERS:
        try:
            worker = Worker(run, script, environment, options.patience)
        except Refused as why:
            say(f"  {name}: left out: {why}")
            continue
        workers.append(worker)
        for rays in sorted({p.rays for p in worker.settings()}):
            here = [tried(Measured(p, name), options) for p in worker.settings() if p.rays == rays]
            found += [m for m in here if m]
            if any(m is None or enough(m, options) for m in here):
                break
    return workers, found


def contenders(measured, options):
    """Those that may be the quickest of their group to an error, by either way of judging, and all of mcvr's own choices."""
    kept = [m for m in measured if m.group == "mcvr auto"]
    for group in {m.group for m in measured}:
        for target in options.errors:
            for key in ("error", "own_error"):
                good = [m for m in measured if m.group == group and (m.rms(key) or math.inf) <= target]
                time = lambda m: m.median(options.clock)
                good.sort(key=time)
                kept += [m for m in good[:PER_TARGET] if time(m) <= 2 * time(good[0])]
    # A peer's plain setting is shown whatever its error.
    plain = [m for m in measured if m.contestant.own_field and m.contestant.setting in PLAIN]
    return [m for m in measured if any(m is k for k in kept + plain)]


def compare(name, threads, options, out):
    scan = scan_args(name, options)
    folder = export(name, scan, options)
    with tempfile.TemporaryDirectory(prefix="peers-") as scratch:
        run = Run(options.mcvr, scan, folder, threads, scratch)
        say(f"{name}, {threads} threads:")
        workers, measured = peers(run, options)
        measured += autos(run, options) + singles(run, options)
        chosen = contenders(measured, options)
        say(f"  {options.rounds} rounds of {len(chosen)} contestants")
        for m in chosen:
            m.took, m.found = [], []
        for turn in range(options.rounds):
            for index in range(len(chosen)):
                m = chosen[(index + turn * 7) % len(chosen)]
                # One view of what takes very long tells enough; the record has the number of views.
                if not m.took or m.median(options.clock) <= 10 * options.longest:
                    m.measure(turn + 1)
        for worker in workers:
            worker.close()
        lines = [json.dumps({"case": name, **m.record(run, any(m is c for c in chosen))}) + "\n" for m in measured]
        out.write("".join(lines))
        out.flush()


def done(path):
    """The scans and threads that a record holds."""
    if not os.path.exists(path):
        return set()
    with open(path, encoding="utf-8") as file:
        return {(r["case"], r["threads"]) for r in map(json.loads, file)}


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--mcvr", required=True, help="the program, built with --release")
    words.add_argument("--scans", required=True, help="folder of the scans named in cases.py")
    words.add_argument("--work", required=True, help="folder for exports and phantoms, some GB; kept between runs")
    words.add_argument("-o", "--output", required=True, help="record, JSON lines, appended to")
    words.add_argument("--only", default=",".join(cases.SCANS), help="scans, separated by commas")
    words.add_argument("--threads", default="1,2", help="numbers of threads")
    words.add_argument("--errors", default="10,3,1,0.3", help="errors to reach, per cent")
    words.add_argument("--rounds", type=int, default=5, help="views of each contestant")
    words.add_argument("--longest", type=float, default=2.0, help="no finer setting is tried once a view takes so many seconds")
    words.add_argument("--patience", type=float, default=120.0, help="seconds after which a peer's view is given up")
    words.add_argument("--clock", choices=("seconds", "cpu"), default="seconds", help="by which clock contenders are chosen")
    words.add_argument("--fresh", action="store_true", help="export again where the program is another one")
    options = words.parse_args()
    options.mcvr = os.path.abspath(options.mcvr)
    options.errors = [float(e) / 100 for e in options.errors.split(",")]
    unknown = [n for n in options.only.split(",") if n not in cases.SCANS]
    if unknown:
        words.error(f"--only {unknown[0]}: the scans are {', '.join(cases.SCANS)}")
    os.makedirs(options.work, exist_ok=True)
    have = done(options.output)
    with open(options.output, "a", encoding="utf-8") as out:
        for name in options.only.split(","):
            for threads in map(int, options.threads.split(",")):
                if (name, threads) not in have:
                    compare(name, threads, options, out)


if __name__ == "__main__":
    main()
