"""Tables of records that compare.py made, as Markdown.

    python table.py peers.jsonl [--clock cpu] [--errors 10,3,1,0.3]

First, per number of threads, the seconds to each error against the pixel-area truth: mcvr's own choice, its best single method,
and each peer's quickest setting. Then the same with each peer judged by its own field, which flatters it: its distance from the
mean over the pixel does not count (and mcvr by the nearer of that mean and the trilinear field's centre rays). Last, the peers'
settings that were measured in turn, with both errors.
"""
import argparse
import json

import cases

PEERS = {"RTK": ["RTK"], "plastimatch": ["plastimatch"], "VTK": ["VTK fixed", "VTK llvmpipe"]}


def read(path):
    with open(path, encoding="utf-8") as file:
        return [json.loads(line) for line in file if line.strip()]


def seconds(value):
    """Three digits with a unit."""
    if value is None:
        return "–"
    for least, unit, factor in ((1, "s", 1), (1e-3, "ms", 1e3)):
        if value >= least:
            return f"{value * factor:.3g} {unit}"
    return f"{value * 1e6:.3g} µs"


def percent(value):
    return "–" if value is None else f"{100 * value:.3g} %"


def quickest(records, target, clock, key="error"):
    good = [r for r in records if r["in_rounds"] and r[key] is not None and r[key] <= target]
    return min(good, key=lambda r: r[clock]["median"], default=None)


def auto(records, target):
    """mcvr's choice for this error, whether or not it kept it."""
    return next((r for r in records if r["group"] == "mcvr auto" and r["setting"] == f"{100 * target:g} %"), None)


def spread(record, clock):
    """Median, and the ends in brackets."""
    times = record[clock]
    return f"{seconds(times['median'])} ({seconds(times['min'])} to {seconds(times['max'])})"


def rows(records, targets, clock, key):
    for case in dict.fromkeys(r["case"] for r in records):
        mine = [r for r in records if r["case"] == case]
        for target in targets:
            choice = auto(mine, target)
            single = quickest([r for r in mine if r["group"] == "mcvr single"], target, clock, key)
            found = {p: quickest([r for r in mine if r["group"] in groups], target, clock, key) for p, groups in PEERS.items()}
            time = lambda r: r[clock]["median"] if r else None
            named = lambda r, name: f"{seconds(time(r))}, {name}" if r else "–"
            best = min((time(r) for r in found.values() if r), default=None)
            missed = f", error {percent(choice[key])}" if choice and choice[key] > target else ""
            ratio = lambda r: f"{best / time(r):.2g}" if r and best else "–"
            yield [
                case,
                f"{100 * target:g} %",
                (seconds(time(choice)) + (f", {choice['chosen']}" if choice["chosen"] else "") + missed) if choice else "–",
                named(single, single and single["setting"]),
                *(named(r, r and f"{r['system'].removeprefix(p).strip()} {r['setting']}".strip()) for p, r in found.items()),
                ratio(choice if not missed else None),
                ratio(single),
            ]


def table(head, body):
    print("| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    for row in body:
        print("| " + " | ".join(row) + " |")
    print()


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("record")
    words.add_argument("--clock", choices=("seconds", "cpu"), default="seconds", help="wall clock, or processor seconds")
    words.add_argument("--errors", default="10,3,1,0.3", help="per cent")
    options = words.parse_args()
    targets = [float(e) / 100 for e in options.errors.split(",")]
    records = read(options.record)
    order = list(cases.SCANS)
    records.sort(key=lambda r: order.index(r["case"]) if r["case"] in order else len(order))
    clock = {"seconds": "wall-clock time", "cpu": "processor time"}[options.clock]
    head = ["scan", "error", "mcvr auto", "best single method", *PEERS, "best peer / auto", "best peer / single"]
    for threads in sorted({r["threads"] for r in records}):
        mine = [r for r in records if r["threads"] == threads]
        views = sorted({r["views"] for r in mine if r["in_rounds"]})
        print(f"## {threads} thread{'s' if threads > 1 else ''}: median {clock} of a view ({min(views)} to {max(views)} views in turn)\n")
        print("Errors against the pixel-area truth:\n")
        table(head, rows(mine, targets, options.clock, "error"))
        print("Peers judged by their own field, exact along one ray a pixel; mcvr by the nearer of the pixel-area truth and those rays:\n")
        table(head, rows(mine, targets, options.clock, "own_error"))
        print("The peers' settings that were measured in turn:\n")
        peers = [r for r in mine if r["own_field"] and r["in_rounds"]]
        table(
            ["scan", "system", "setting", "a view", "error", "own error", "own field"],
            (
                [r["case"], r["system"], r["setting"], spread(r, options.clock), percent(r["error"]), percent(r["own_error"])]
                + [r["own_field"].removeprefix("centre-")]
                for r in peers
            ),
        )
    print("Measured on " + "; ".join(sorted({r["machine"] for r in records})) + ", ", end="")
    print(f"{min(r['when'] for r in records)} to {max(r['when'] for r in records)}. Versions:")
    for version in sorted({f"- {r['system'] if r['own_field'] else 'mcvr'}: {r['version']}" for r in records}):
        print(version)


if __name__ == "__main__":
    main()
