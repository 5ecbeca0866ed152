"""How families, culprits and objects of dense recordings are told: `python -m proof.dense FOLDER`.

With --plan pressed, of skins that are touched; with --plan objects, of several objects each. One
row a recording of `witness.dense`, written as JSON; a second run goes on where the first was. The
table has, over everything drawn, how much of the misfit of readings put aside is closed, sizes of
families against the rms of the values drawn, culprits and objects by place, and false ones.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from eitskin.atomic import atomic_path
from eitskin.diagnose import diagnosis
from eitskin.diagnose.verdict.conclusion import document
from proof.intervals import wilson
from proof.markdown import table
from witness.dense import ENDINGS, OBJECTS, PRESSED, PROTOCOLS, Dense, draw

FIRST_SEED = 910_001  # none of these had been drawn before the families were written
FIRST_PRESSED_SEED = 920_001  # nor of these
FIRST_OBJECTS_SEED = 930_001  # nor of these before objects came before other names
Disc = tuple[complex, bool]  # place in shares of the radius, and whether it conducts better
PLANS = ("untouched", "pressed", "objects")
NEAR = 0.14  # of the radius: a grid step of the scans with which objects are usually sought
NAMED_SHARE = 0.2  # of the misfit, from which on a family ought to be told
WITHIN = 1.5  # of the rms of the values drawn: a size that is right


def trials(count: int, plan: str = PLANS[0]) -> list[tuple[str, int]]:
    """Kinds and seeds of the first recordings of a plan, protocols and endings in turn: untouched;
    pressed, of skins that are touched; or objects, of several objects each."""
    if plan == "objects":
        kinds = [f"dense:{protocol}{OBJECTS}" for protocol in PROTOCOLS]
        return [(kinds[2 * k % len(kinds)], FIRST_OBJECTS_SEED + k) for k in range(count)]
    if plan == "pressed":
        kinds = [f"{PRESSED}{p}{e}" for e in ENDINGS if e != " object" for p in PROTOCOLS]
        return [(kinds[7 * k % len(kinds)], FIRST_PRESSED_SEED + k) for k in range(count)]
    kinds = [f"dense:{protocol}{ending}" for ending in ENDINGS for protocol in PROTOCOLS]
    return [(kinds[7 * k % len(kinds)], FIRST_SEED + k) for k in range(count)]


def row(kind: str, seed: int) -> dict:
    """One recording diagnosed, beside its truth."""
    drawn = draw(kind, seed)
    start = time.process_time()
    diagnosed = diagnosis.diagnose(drawn.recorded)
    content = document(diagnosed, f"{kind} {seed}")
    fits = {"before": diagnosed.baseline.fit, "after": diagnosed.explanation.fit}
    errors = {
        key: float(np.sqrt(((fit.voltage() - drawn.clean) ** 2).mean()))
        for key, fit in fits.items()
    }
    return {
        "kind": kind,
        "seed": seed,
        "cpu_seconds": time.process_time() - start,
        "verdict": content["verdict"],
        "effects": [
            {key: effect.get(key) for key in ("name", "certain", "stands_out", "parameters")}
            | {"sites": _sites(effect)}
            for effect in content["effects"]
        ],
        "families": content.get("families", []),
        "scale": content.get("scale"),
        "last": content["fit"].get("last"),
        "error_V": errors,
        "truth": truth_of(drawn),
    }


def _sites(effect: dict) -> list[int]:
    return next((effect[k] for k in ("electrodes", "drives", "measures") if effect[k]), [])


def truth_of(drawn: Dense) -> dict:
    """What a row tells of a recording's truth: rms of the families' values, culprits, objects, the
    memory and the skin's radius in mm."""
    rms = {name: float(np.sqrt((v**2).mean())) for name, v in drawn.families.items()}
    return {
        "rms": rms,
        "culprits": drawn.culprits,
        "objects": drawn.objects,
        "memory": drawn.memory,
        "radius_mm": drawn.true.radius_mm,
    }


def scores(rows: list[dict]) -> list[tuple[str, str, int]]:
    """What was measured, value by value: a name, the measured value, the number of cases."""
    closed = [
        1.0 - (r["last"]["rms_after_V"] / r["last"]["rms_before_V"]) ** 2 for r in rows if r["last"]
    ]
    worse = [r["last"]["rms_after_V"] > r["last"]["rms_before_V"] for r in rows if r["last"]]
    sizes = [
        max(f["sd"]["value"], r["truth"]["rms"][f["name"]])
        <= WITHIN * min(f["sd"]["value"], r["truth"]["rms"][f["name"]])
        for r in rows
        for f in r["families"]
        if f["share"] >= NAMED_SHARE and f["name"] in r["truth"]["rms"]
    ]
    judged = [objects_of(r) for r in rows if r["truth"]["objects"]]
    false_objects = [
        any(e["name"] == "conductivity-patch" for e in r["effects"])
        for r in rows
        if not r["truth"]["objects"]
    ]
    culprits = [
        _finds_culprit(r, culprit)
        for r in rows
        for culprit in r["truth"]["culprits"]
        if culprit["ratio"] >= 8.0
    ]
    false_sites = [_has_false_site(r) for r in rows]
    seconds = [r["cpu_seconds"] for r in rows]
    return [
        ("misfit put aside that is closed, median", f"{np.median(closed):.4f}", len(closed)),
        ("the same, fifth percentile", f"{np.quantile(closed, 0.05):.4f}", len(closed)),
        ("after worse than before on readings put aside", *rate(worse)),
        ("sizes of families of share 20 % or more within 1.5 times", *rate(sizes)),
        ("culprits that stand out by 8 or more: site and name", *rate(culprits)),
        ("recordings with a false culprit, certain", *rate(false_sites)),
        (
            "recordings with objects: one within 14 % of the radius, of its sign",
            *rate([any(near) for near, _ in judged]),
        ),
        ("the same: all of them", *rate([all(near) for near, _ in judged])),
        ("the same: one elsewhere", *rate([any(stray) for _, stray in judged])),
        ("recordings without an object: one named", *rate(false_objects)),
        ("processor seconds, median", f"{np.median(seconds):.0f}", len(seconds)),
        ("processor seconds, largest", f"{max(seconds):.0f}", len(seconds)),
    ]


def rate(hits: list[bool]) -> tuple[str, int]:
    """A share with its interval as a cell of a table, and of how many it is."""
    if not hits:
        return "none drawn", 0
    low, high = wilson(sum(hits), len(hits))
    share = f"{100 * np.mean(hits):.0f} % ({100 * low:.0f} to {100 * high:.0f} %)"
    return f"{sum(hits)} of {len(hits)}, {share}", len(hits)


def near_and_stray(named: list[Disc], truth: list[Disc]) -> tuple[list[bool], list[bool]]:
    """Of each true object, whether one of its sign is named within NEAR; of each that is named,
    whether none is there."""
    near = [
        any(abs(place - centre) <= NEAR and sign is conducts for place, sign in named)
        for centre, conducts in truth
    ]
    return near, [all(abs(place - centre) > NEAR for centre, _ in truth) for place, _ in named]


def objects_of(entry: dict) -> tuple[list[bool], list[bool]]:
    """`near_and_stray` of a row; lengths in mm are shares of the radius that was taken."""
    true_mm = entry["truth"]["radius_mm"]
    radius_mm = (entry.get("scale") or {"radius_mm": true_mm})["radius_mm"]
    named = [
        {key: value["value"] for key, value in e["parameters"].items()}
        for e in entry["effects"]
        if e["name"] == "conductivity-patch"
    ]
    truth = [law["parameters"] for law in entry["truth"]["objects"]]
    return near_and_stray([_disc(v, radius_mm) for v in named], [_disc(v, true_mm) for v in truth])


def _disc(values: dict, radius_mm: float) -> Disc:
    place = complex(values["x_mm"], values["y_mm"]) / radius_mm
    return place, values["contrast"] > 1.0


def _finds_culprit(entry: dict, culprit: dict) -> bool:
    return any(
        e["name"] == culprit["name"] and culprit["site"] in e["sites"] for e in entry["effects"]
    )


def _has_false_site(entry: dict) -> bool:
    sites = {(c["name"], c["site"]) for c in entry["truth"]["culprits"]}
    return any(
        e["certain"] and e["sites"] and not any((e["name"], s) in sites for s in e["sites"])
        for e in entry["effects"]
    )


def main() -> None:
    """Run the trials that have no row yet, then print the table."""
    parser = argparse.ArgumentParser(prog="python -m proof.dense")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--plan", choices=PLANS, default=PLANS[0])
    parser.add_argument("--only-table", action="store_true")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for kind, seed in trials(arguments.count, arguments.plan):
        path = arguments.folder / f"{kind.replace(':', '-').replace(' ', '-')}-{seed}.json"
        if not path.exists():
            if arguments.only_table:
                continue
            with atomic_path(path) as target:
                target.write_text(json.dumps(row(kind, seed)) + "\n", encoding="utf-8")
        rows.append(json.loads(path.read_text(encoding="utf-8")))
        print(f"{kind} {seed}: {rows[-1]['verdict']}", flush=True)
    print("\n".join(table(("what", "measured", "n"), scores(rows))))


if __name__ == "__main__":
    main()
