"""`python -m proof.absolute OUT`: objects in real tanks from one frame, without an empty one.

Every frame with objects that another laboratory published, as `proof.objects` lists them (of the
rod every tenth), is diagnosed alone, as `eitskin diagnose FILE --part PART` does, and so is every
empty tank. Where the objects are is taken from `eitskin compare`, which has the empty tank beside
the same frame (`proof.objects`). One row a frame, written as JSON: a second run goes on where the
first was.
"""

import argparse
import json
import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from eitskin.atomic import atomic_path
from eitskin.data.reading import read
from eitskin.diagnose import diagnosis
from eitskin.diagnose.compare.objects import NAME
from eitskin.diagnose.verdict.conclusion import document
from proof.dense import near_and_stray, rate
from proof.markdown import table
from proof.objects import ROD, TEN, Case, answer, cases, judged


def frames(data: Path) -> list[Case]:
    """The frames that are diagnosed, of the rod every tenth, each with its file and part; names of
    pyeidors-tank's empty ones are of two files, of which the later is meant."""
    ten = {f"{ROD} rod {k:02d}" for k in TEN}
    return [case for case in cases(data) if not case.name.startswith(ROD) or case.name in ten]


def row(case: Case) -> dict:
    """One frame diagnosed, its objects and where they are in shares of the tank's radius."""
    recorded = read(str(case.later), part=case.part)
    start = time.process_time()
    diagnosed = diagnosis.diagnose(recorded)
    content = document(diagnosed, case.name)
    seconds = time.process_time() - start
    radius_mm = diagnosed.search.problem.model.nominal_skin.radius_mm
    return {
        "case": case.name,
        "truth": places(case),
        "cpu_seconds": seconds,
        "verdict": content["verdict"],
        "effects": [
            {key: effect.get(key) for key in ("name", "certain", "stands_out", "parameters")}
            for effect in content["effects"]
        ],
        "families": content.get("families", []),
        "held_out": content["fit"]["held_out"],
        "last": content["fit"].get("last"),
        "objects": [
            {
                "x": effect["parameters"]["x_mm"]["value"] / radius_mm,
                "y": effect["parameters"]["y_mm"]["value"] / radius_mm,
                "contrast": effect["parameters"]["contrast"]["value"],
                "certain": effect["certain"],
            }
            for effect in content["effects"]
            if effect["name"] == NAME
        ],
    }


def places(case: Case) -> list[tuple[float, float, bool]]:
    """Where a comparison with the empty tank has a case's objects, x and y in shares of the radius,
    and whether each conducts better; of an empty tank none."""
    if case.truth == ():
        return []
    with TemporaryDirectory() as folder:
        objects = judged(case, answer(case, 0, Path(folder)))
    keys = ("x", "y", "conducting")
    x, y, signs = (objects[key].split() for key in keys)
    return [(float(a), float(b), s == "+") for a, b, s in zip(x, y, signs, strict=True)]


def scored(entry: dict) -> dict:
    """A frame's row, its objects counted by where they are.

    near: truths with an object of their sign within NEAR; stray: objects with no truth there.
    """
    named = [(complex(o["x"], o["y"]), o["contrast"] > 1.0) for o in entry["objects"]]
    truth = [(complex(x, y), conducts) for x, y, conducts in entry["truth"]]
    near, stray = near_and_stray(named, truth)
    last = entry["last"]
    return {
        "frame": entry["case"],
        "objects": len(truth),
        "named": len(named),
        "near": sum(near),
        "stray": sum(stray),
        "certain": sum(o["certain"] for o in entry["objects"]),
        "beside": ", ".join(e["name"] for e in entry["effects"] if e["name"] != NAME),
        "left": last["rms_after_V"] / last["rms_before_V"] if last else float("nan"),
        "seconds": entry["cpu_seconds"],
    }


def page(scores: list[dict]) -> list[str]:
    """Lines of Markdown: what was measured, then every frame."""
    full = [s for s in scores if s["objects"]]
    empty = [s for s in scores if " empty " in s["frame"]]
    lines = [
        ("frames with objects: one of them within 14 % of the radius", full, "near"),
        ("objects that are elsewhere", full, "stray"),
        ("empty tanks: an object named", empty, "named"),
    ]
    cells = [(what, *rate([s[key] > 0 for s in group])) for what, group, key in lines]
    every = [s["near"] == s["objects"] for s in full]
    cells.insert(1, ("the same: all of them", *rate(every)))
    worse = [s["left"] > 1.0 for s in scores if s["left"] == s["left"]]
    cells.append(("after worse than before on readings put aside", *rate(worse)))
    head = tuple(scores[0])
    rows = [
        tuple(
            f"{v:.2f}" if key == "left" else f"{v:.0f}" if key == "seconds" else v
            for key, v in s.items()
        )
        for s in scores
    ]
    return [*table(("what", "measured", "n"), cells), "", *table(head, rows)]


def main() -> None:
    """Diagnose the frames that have no row yet, then print the tables."""
    parser = argparse.ArgumentParser(prog="python -m proof.absolute")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="cases whose names begin so")
    folder, only = (vars(parser.parse_args())[key] for key in ("folder", "only"))
    folder.mkdir(parents=True, exist_ok=True)
    scores = []
    for case in frames(Path(os.environ["EITSKIN_DATA"])):
        path = folder / f"{case.name.replace(' ', '-')}.json"
        if not path.exists():
            if not case.name.startswith(only):
                continue
            with atomic_path(path) as target:
                target.write_text(json.dumps(row(case)) + "\n", encoding="utf-8")
        scores.append(scored(json.loads(path.read_text(encoding="utf-8"))))
        print(f"{case.name}: {scores[-1]}", flush=True)
    print("\n".join(page(scores)))


if __name__ == "__main__":
    main()
