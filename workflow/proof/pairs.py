"""`python -m proof.pairs BLOCK OUT`: faults between two sessions of one skin, found or not.

BLOCK is development, report, or second-report and third-report, of other seeds: on the first two,
thresholds were set. A run goes on where an earlier one of the same folder was stopped.

A control recording and a later one of the same skin (`pair_skins`) are compared as `eitskin
compare` does, with one of ten faults of the instrument planted in the later one, in a third of all
from somewhere in its middle on, or with none. Its SNR is log-uniform in 8 to 40, of the sessions'
difference in units of what that is without a fault, beside an overall factor (`planted`); crossed
wires, lost channels and what has a largest size show what they show.
"""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data.recording import Recording
from eitskin.diagnose.compare.difference import Difference, Finding, difference
from eitskin.diagnose.compare.wander import wander
from eitskin.effects import catalogue_names, modules
from eitskin.fingerprint import fingerprint
from eitskin.quantities import percent
from proof import ledger, markdown, pair_skins, planted
from proof.intervals import wilson
from proof.judge import site_kind
from proof.pair_skins import DEVELOPMENT, REPORT, SECOND, SIMULATED, THIRD, Sessions
from witness.laws import SITES

NAMES = ("control", "later")
MIDDLE = (0.3, 0.7)  # of the later recording, where a third of all faults begin
ENOUGH = 8.0  # SNR in the difference, as `measures.APART` of a recording
TINY_V = 1e-12  # far below any instrument's noise
CODE = fingerprint("trials", [*modules(catalogue_names()), "proof.pairs"])
CATALOGUE = {"clipping": "adc-nonlinearity"}
# Pairs a kind and pairs without a fault, of each source.
NUMBERS = {
    DEVELOPMENT: {
        "hydrogel-skin-16": (3, 12),
        "hydrogel-skin-8": (3, 8),
        "iirc-tank": (2, 8),
        SIMULATED: (6, 30),
    },
}
NUMBERS[REPORT] = NUMBERS[SECOND] = NUMBERS[THIRD] = {
    "hydrogel-skin-16": (3, 12),
    "hydrogel-skin-8": (2, 8),
    "iirc-tank": (2, 8),
    "lct-tank": (1, 3),
    SIMULATED: (5, 30),
}


@dataclass(frozen=True)
class Case:
    """A pair as it is compared: the fault {name, sites, parameters} in `later` from a row on, None
    without one; snr: of it in the sessions' difference, snr_frame: in a frame's white noise."""

    control: Recording
    later: Recording
    fault: dict | None
    since: int
    snr: float
    snr_frame: float


def draw(block: str, source: str, kind: str, number: int) -> Case | None:
    """One pair of a source, a fault of planted.FAULTS or none; None where that cannot be planted.

    The sessions are the same for all kinds of a source and number.
    """
    make = pair_skins.sources(block)[source]
    sessions = make(np.random.default_rng([crc32(f"{block}:{source}".encode()), number]))
    if kind == planted.NONE:
        return Case(sessions.control, sessions.later, None, 0, 0.0, 0.0)
    rng = np.random.default_rng([crc32(f"{block}:{source}:{kind}".encode()), number])
    harmed = _harmed(sessions, kind, rng)
    if harmed is None:
        return None
    voltage, fault, snr = harmed
    plain, since = sessions.later.readings, 0
    if len(plain) > 8 and rng.uniform() < 1.0 / 3.0:
        earliest, latest = (round(share * len(plain)) for share in MIDDLE)
        since = int(rng.integers(earliest, latest))
        voltage = np.concatenate([plain[:since], voltage[since:]])
    noise = wander(sessions.control.readings, plain).noise
    mean_change = np.nan_to_num(voltage[since:] - plain[since:]).mean(axis=0)
    snr_frame = float(np.linalg.norm(mean_change / np.maximum(noise, TINY_V)))
    later = replace(sessions.later, voltage=voltage)
    return Case(sessions.control, later, fault, since, snr, snr_frame)


def _harmed(
    sessions: Sessions, kind: str, rng: np.random.Generator
) -> tuple[np.ndarray, dict, float] | None:
    """The later readings with a fault, the fault, and its SNR in the difference."""
    session_wander = wander(sessions.control.readings, sessions.later.readings)
    noise = np.maximum(session_wander.scale * max(session_wander.relative_rms, 1.0), TINY_V)
    if kind == "electrode-swap" and sessions.crossed is not None:
        electrodes, crossed = sessions.crossed
        mean_change = (crossed.readings - sessions.later.readings).mean(axis=0) / noise
        swap = {"name": kind, "electrodes": list(electrodes), "parameters": {}}
        return crossed.readings, swap, float(np.linalg.norm(mean_change))
    if not planted.can_plant(sessions.later, kind):
        return None
    fault, snr = planted.draw_fault(rng, kind, sessions.later, noise)
    assert fault is not None  # `kind` names one
    return planted.plant(sessions.later, [fault]), fault, snr


def judged(case: Case, answer: Difference) -> dict:
    """A row of the table: what was planted, what was said, and whether that is right.

    at_site: the site, or without a site the name, is given and nothing else is; named: the name
    also, or one that the untouched skin cannot tell from it; false: anything is given that is not.
    """
    named = [entry for entry in answer.findings if entry.named]
    fault = case.fault
    row: dict[str, Any] = {
        "fault": fault["name"] if fault else planted.NONE,
        "where": _where(fault) if fault else "",
        "since": case.since,
        "snr": case.snr,
        "snr_frame": case.snr_frame,
        "said": "; ".join(_said(entry) for entry in named),
        "evidence": answer.findings[0].explanation.evidence if answer.findings else None,
        "margin": min(answer.findings[0].margin, 1e6) if answer.findings else None,
        "said_since": named[0].onset_row if named else -1,
    }
    if answer.lost_channels:
        row["said"] = "; ".join(filter(None, [row["said"], f"lost {list(answer.lost_channels)}"]))
    if fault is None:
        return row | {"at_site": False, "named": False, "false": bool(row["said"])}
    if fault["name"] == "lost-channels":
        at_site = list(answer.lost_channels) == fault["channels"]
        return row | {"at_site": at_site and not named, "named": at_site, "false": bool(named)}
    name = CATALOGUE.get(fault["name"], fault["name"])
    kind = site_kind(fault)
    place = (kind, tuple(sorted(fault[kind]))) if kind else (None, ())
    at_site = [
        entry
        for entry in named
        if entry.explanation.place == place and (kind or name in (entry.name, *entry.alternatives))
    ]
    by_name = [entry for entry in at_site if name in (entry.name, *entry.alternatives)]
    return row | {
        "at_site": len(at_site) == 1 == len(named),
        "named": bool(by_name),
        "false": len(named) > len(at_site) or bool(answer.lost_channels),
    }


def _where(fault: dict) -> str:
    return " ".join(f"{kind} {fault[kind]}" for kind in SITES if fault.get(kind))


def _said(entry: Finding) -> str:
    kind, sites = entry.explanation.place
    return f"{entry.name} {kind} {[int(s) for s in sites]}" if kind else entry.name


def rows(block: str, folder: Path) -> pd.DataFrame:
    """Every pair of a block, judged; those that this code left in the folder are taken from
    there."""
    judged_rows = []
    available = pair_skins.sources(block)
    for source, (fault_count, null_count) in NUMBERS[block].items():
        if source not in available:
            continue
        plan = [(kind, i) for kind in planted.FAULTS for i in range(fault_count)]
        plan += [(planted.NONE, i) for i in range(null_count)]
        for kind, number in plan:
            file = folder / "rows" / f"{source}-{kind}-{number}.json"
            if not (file.exists() and json.loads(file.read_text("utf-8"))["code"] == CODE):
                ledger.write(file, {"code": CODE, "row": _row(block, source, kind, number)})
            row = json.loads(file.read_text("utf-8"))["row"]
            if row is not None:
                judged_rows.append(row)
    return pd.DataFrame(judged_rows)


def _row(block: str, source: str, kind: str, number: int) -> dict | None:
    case = draw(block, source, kind, number)
    if case is None:
        return None
    answer = difference(case.control, case.later, NAMES)
    head = {"source": source, "kind": kind, "number": number, "electrodes": answer.pair.n}
    return head | judged(case, answer)


def table(judged_rows: pd.DataFrame) -> str:
    """Markdown: what was found, and what was said without a fault, with 95 % intervals."""
    faults = judged_rows[judged_rows["kind"] != planted.NONE]
    exact = faults["kind"].isin(["lost-channels", "electrode-swap"])
    visible = faults[exact | (faults["snr"] >= ENOUGH / 1.05)]
    nulls = judged_rows[judged_rows["kind"] == planted.NONE]
    lines = [
        _line(f"a fault of SNR {ENOUGH:g} or more in the difference", visible),
        _line("a fault of less", faults.drop(visible.index)),
        _line("no fault", nulls),
    ]
    for source, members in visible.groupby("source", sort=False):
        lines.append(_line(f"{source}: a fault", members))
        lines.append(_line(f"{source}: no fault", nulls[nulls["source"] == source]))
    for kind, members in visible.groupby("kind", sort=False):
        lines.append(_line(str(kind), members))
    late_start = visible[visible["since"] > 0]
    lines.append(_line("from within the later recording on", late_start))
    located = late_start[late_start["at_site"]]
    frame_errors = (located["said_since"] - located["since"]).abs()
    head = ("pairs", "n", "at the site", "by name", "something false")
    text = (
        f"Where it began within: {int((frame_errors <= 2).sum())} of {len(frame_errors)} found"
        " beginnings are right to two frames.\n"
    )
    return "\n".join([*markdown.table(head, lines), "", text])


def _line(name: str, members: pd.DataFrame) -> tuple:
    keys = ("at_site", "named", "false")
    return name, len(members), *(_share(int(members[key].sum()), len(members)) for key in keys)


def _share(hits: int, n: int) -> str:
    if n == 0:
        return ""
    low, high = wilson(hits, n)
    return f"{hits}: {percent(hits / n)} ({percent(low)} to {percent(high)})"


def main(block: str, folder: Path) -> None:
    """Write pairs.csv and pairs.md of a block."""
    (folder / "rows").mkdir(parents=True, exist_ok=True)
    judged_rows = rows(block, folder)
    text = table(judged_rows)
    for name, content in (("pairs.csv", judged_rows.to_csv(index=False)), ("pairs.md", text)):
        with atomic_path(folder / name) as temporary:
            temporary.write_text(content, "utf-8")
    print(text, end="")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
