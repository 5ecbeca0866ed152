"""Whether a diagnosis is silent, names a stretch of frames or states one number, where that and
nothing else is right (`witness.controls`).

A recording that breaks off counts as a miss in every claim of its kind. An alarm: a name, other
physics that is likely, or a verdict that is not consistent. The interval of a common part is that
of the effect that it is, else of what presses share of the rig's errors; its standard error is half
of that over NORMAL_90, or where nothing is stated the least possible: the rig's own error over the
root of the presses, and the white noise. A common part without an interval counts as not held.

Measured by
snakemake --cores 2 calibrate_diagnosis --config "calibration={block: controls-report, size: full}"
and, a twelfth of it, with size: quick; controls-development has other seeds, to tune on.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd

from eitskin.diagnose.noise.noise_model import NORMAL_90
from eitskin.diagnose.verdict.words import is_certain
from proof import measures
from proof.claims import Condition, Rows, summary
from proof.intervals import share
from proof.measures import is_alarm, is_broken, is_flagged, is_named
from witness.controls import QUANTITIES, WHITE_PERCENT

CLEAR = 4.0  # standard errors from which a common part has to be named
MOST = 0.9  # of the frames of unlabelled presses
VISIBLE = 8.0  # SNR of a touch from which its frame is plain
WHITE = tuple(f"white-{percent}" for percent in WHITE_PERCENT)
FRAMES = ("single-frame", "averaged-frames")
UNLABELLED = ("unlabelled-white", "unlabelled-alien")
COMPONENT = {  # of the rig's errors, whose common part a quantity is
    "common-place": "place-per-press",
    "common-force-zero": "force-zero-per-press",
    "common-force-factor": "force-per-press",
    "delay-force": "force-delay",
    "delay-pose": "place-delay",
}
CONTROL = (
    *("kind", "seed", "generator", "level", "rig", "truth", "snr", "names", "certain", "other"),
    *("verdict", "held", "standard_errors", "unlabelled", "said_frames", "seconds", "why"),
)
Estimate = tuple[float, float, float]  # true value, ends of the interval


def kind_of(row: dict) -> str:
    """A key of `controls.KINDS`."""
    return row["kind"].partition(":")[2]


def is_control(*kinds: str) -> Condition:
    """Whether a row is of one of these kinds."""
    return lambda row: kind_of(row) in kinds


def has_certain(row: dict) -> bool:
    """Whether an effect is named as a finding, or a step is said."""
    return any(map(is_certain, row["said"]["effects"])) or bool(row["said"].get("steps"))


def is_loud(row: dict) -> bool:
    """Whether anything is said to be left out."""
    return is_named(row) or is_flagged(row) or row["said"]["verdict"] != "consistent"


def common_estimates(row: dict) -> list[Estimate]:
    """What is stated of a row's common part, a number each; none where nothing is."""
    common, said = row["common"], row["said"]
    true = common["parameters"]
    for entry in said["effects"]:
        if entry["name"] == common["name"]:
            estimates = [entry["parameters"][key] for key in true]
            ends = [(float(e["low"]), float(e["high"])) for e in estimates]
            return [(value, *end) for value, end in zip(true.values(), ends, strict=True)]
    name = COMPONENT[kind_of(row)]
    stated = [c for c in said["noise"]["components"] if c["name"] == name and "common" in c]
    if not stated:
        return []
    (component,) = stated
    low, high = (np.ravel(component["common"][end]).tolist() for end in ("low", "high"))
    values = [value - _nothing(row) for value in true.values()]
    return list(zip(values, low, high, strict=True))


def _nothing(row: dict) -> float:
    """The value of a common part that changes nothing."""
    return 1.0 if kind_of(row) == "common-force-factor" else 0.0


def standard_errors(row: dict) -> float:
    """How many of its standard errors a common part is, the most of its numbers."""
    estimates = common_estimates(row)
    common, nothing = row["common"], _nothing(row)
    sizes = np.array(list(common["parameters"].values())) - nothing
    if estimates:
        half = np.array([0.5 * (high - low) for _, low, high in estimates])
        return float(np.abs(sizes / (np.maximum(half, 1e-300) / NORMAL_90)).max())
    size = float(np.linalg.norm(sizes))
    own = common["own"] / np.sqrt(common["presses"])
    return float(size / np.hypot(own, size / common["snr"]))


def is_clear(row: dict) -> bool:
    """Whether a common part has to be named; of one that broke off, too."""
    return is_broken(row) or standard_errors(row) >= CLEAR


def has_common_named(row: dict) -> bool:
    """Whether an effect is the common part, by its name or an alternative; where the catalogue has
    no name for it, whether its interval is without nothing."""
    if is_broken(row):
        return False
    name = row["common"]["name"]
    if name is None:
        return any(low > 0.0 or high < 0.0 for _, low, high in common_estimates(row))
    return any(name in (entry["name"], *entry["alternatives"]) for entry in row["said"]["effects"])


def held(rows: Rows) -> dict:
    """Share of the numbers of common parts that lie in their intervals."""
    return _held(rows, lambda row: len(row["common"]["parameters"]))


def held_where_stated(rows: Rows) -> dict:
    """`held`, of those with an interval."""
    stated = [row for row in rows if not is_broken(row)]
    return _held(stated, lambda row: len(common_estimates(row)))


def _held(rows: Rows, numbers: Callable[[dict], int]) -> dict:
    hits = n = 0
    for row in rows:
        n += 1 + (kind_of(row) == "common-place") if is_broken(row) else numbers(row)
        hits += 0 if is_broken(row) else sum(map(_is_held, common_estimates(row)))
    return share(hits, n)


def _is_held(estimate: Estimate) -> bool:
    true, low, high = estimate
    return low <= true <= high


def has_interval(row: dict) -> bool:
    """Whether anything is stated of a common part."""
    return not is_broken(row) and bool(common_estimates(row))


def said_frames(row: dict) -> set[int]:
    """Frames that are said to be of a touch without a label."""
    stretches = row["said"]["noise"].get("unlabelled", [])
    return {frame for first, end in stretches for frame in range(first, end + 1)}


def _frames_named(least_snr: float) -> Callable[[dict], list[float]]:
    """The share of the frames of a row's unlabelled presses, of that SNR or more, that are said to
    be of one; nothing where there is no such frame."""

    def named(row: dict) -> list[float]:
        if is_broken(row):
            return [0.0]
        said = said_frames(row)
        hits = [
            stretch["first"] + i in said
            for stretch in row["unlabelled"]
            for i, snr in enumerate(stretch["snr"])
            if snr >= least_snr
        ]
        return [float(np.mean(hits))] if hits else []

    return named


def has_most_frames_named(row: dict) -> bool:
    """Whether nine of ten frames of a row's unlabelled presses are said to be of one."""
    return _frames_named(0.0)(row) >= [MOST]


def has_frame_wrongly_named(row: dict) -> bool:
    """Whether a frame in which nobody touches, or with a label, is said to be of one."""
    true = {
        frame
        for stretch in row["unlabelled"]
        for frame in range(stretch["first"], stretch["last"] + 1)
    }
    return bool(said_frames(row) - true)


def has_pair_named(row: dict) -> bool:
    """Whether all effects are named and nothing else."""
    return not is_broken(row) and measures.has_all_right(row)


WORDS = replace(
    measures.WORDS,
    conditions={
        **{f"{name} %": is_control(name) for name in WHITE},
        **{name: is_control(name) for name in (*FRAMES, *UNLABELLED, *QUANTITIES)},
        "white": is_control(*WHITE),
        "frames": is_control(*FRAMES),
        "unlabelled": is_control(*UNLABELLED),
        "common force": is_control("common-force-zero", "common-force-factor"),
        "delay": is_control("delay-force", "delay-pose"),
        "pair": is_control("strong-pair"),
        "clear": is_clear,
        "named": is_alarm(is_named),
        "certain": is_alarm(has_certain),
        "alarm": is_alarm(is_loud),
        "interval": has_interval,
        "common named": has_common_named,
        "most frames named": has_most_frames_named,
        "frame wrongly named": is_alarm(has_frame_wrongly_named),
        "pair named": has_pair_named,
        "broken off": is_broken,
    },
    numbers={
        **measures.WORDS.numbers,
        "frames named": _frames_named(0.0),
        "plain frames named": _frames_named(VISIBLE),
    },
    measures={"held": held, "held where stated": held_where_stated},
)
COMMON = """
{subject}
  90 % intervals that hold the common part, a miss where none is stated | {kind} | held | {gate}
  90 % intervals that hold the common part, of those stated | {kind} | held where stated
  an interval of the common part stated | {kind} | share interval
  named, at 4 standard errors or more | {kind}, clear | share common named | {named}
"""
GATED = {
    "places off alike": "common-place",
    "forces off alike": "common force",
    "delays": "delay",
}
PARTS = {
    "a zero of the load cell": "common-force-zero",
    "a factor of the load cell": "common-force-factor",
    "delays of the force": "delay-force",
    "delays of the pose, of touches that slide": "delay-pose",
}
CLAIMS = WORDS.claims(
    """
nulls of white noise
  a certain name | white | share certain | ≤ 0
  any name | white | share named
"""
    + "".join(
        f"  a certain name, {name.removeprefix('white-')} % | {name} % | share certain\n"
        f"  any name, {name.removeprefix('white-')} % | {name} % | share named\n"
        for name in WHITE
    )
    + """
untouched frames
  any alarm | frames | share alarm | ≤ 0.03
  any alarm, single frames | single-frame | share alarm
  any alarm, means of 2 to 100 | averaged-frames | share alarm
presses without a label
  share of their frames that is named | unlabelled | mean frames named | ≥ 0.9
  share of their frames of SNR 8 or more that is named | unlabelled | mean plain frames named
  nine of ten of their frames named | unlabelled | share most frames named
  nine of ten of their frames named, white noise | unlabelled-white | share most frames named
  nine of ten of their frames named, alien rigs | unlabelled-alien | share most frames named
  a frame wrongly named | unlabelled | share frame wrongly named
  a certain name or a step, of which none is true | unlabelled | share certain | ≤ 0.01
"""
    + "".join(
        COMMON.format(subject=subject, kind=kind, gate="0.85 to 0.95", named="≥ 0.9")
        for subject, kind in GATED.items()
    )
    + "".join(
        COMMON.format(subject=subject, kind=kind, gate="", named="")
        for subject, kind in PARTS.items()
    )
    + """
pairs 400 to 1,500 times the noise
  both named, nothing else | pair | share pair named | ≥ 0.9
the run
  recordings broken off | all | share broken off
  seconds a diagnosis, median | all | median seconds
  seconds a diagnosis, worst | all | largest seconds
  processor seconds a diagnosis, median | all | median processor seconds
"""
)


def scored(rows: Rows) -> tuple[dict[str, pd.DataFrame], str]:
    """The tables of `blocks.TABLES` of controls, and a note."""
    lines = pd.DataFrame(list(map(_line, rows)), columns=list(CONTROL))
    return {"summary": summary((rows, CLAIMS)), "controls": lines}, "two solvers by turns"


def _line(row: dict) -> dict:
    """One row (CONTROL) a recording. held: numbers of its common part that their intervals hold, of
    all; why: what a recording that broke off ended with."""
    line = {"kind": kind_of(row), "seed": row["seed"], "why": row.get("failed", "")}
    if is_broken(row):
        return line
    said, common = row["said"], row.get("common")
    line |= {key: row[key] for key in ("generator", "level", "seconds")}
    line |= {
        "rig": ", ".join(f"{error['kind']} {error['size']:.3g}" for error in row["rig"]),
        "truth": "; ".join(f"{true['name']} {true['parameters']}" for true in row["truth"]),
        "snr": "; ".join(f"{snr:.4g}" for snr in row["snr"]),
        "names": "; ".join("/".join([e["name"], *e["alternatives"]]) for e in said["effects"]),
        "certain": has_certain(row),
        "other": said["other"]["probability"],
        "verdict": said["verdict"],
    }
    if common is not None:
        hits = sum(map(_is_held, common_estimates(row)))
        line |= {
            "truth": f"{common['name'] or 'pose'} {common['parameters']}",
            "snr": f"{common['snr']:.4g}",
            "held": f"{hits} of {len(common['parameters'])}",
            "standard_errors": standard_errors(row),
        }
    if row["unlabelled"]:
        true = [[stretch["first"], stretch["last"]] for stretch in row["unlabelled"]]
        line |= {"unlabelled": true, "said_frames": said["noise"].get("unlabelled", [])}
    return line
