"""One recording with known truth: drawn, diagnosed, and what came of it kept as a row."""

import json
import time
import traceback
from dataclasses import replace
from pathlib import Path

import numpy as np

from eitskin.atomic import atomic_path
from eitskin.diagnose import diagnose
from eitskin.diagnose.candidates import Candidate
from eitskin.diagnose.fit import fit
from eitskin.diagnose.gaps import Gap, gaps
from eitskin.errors import InputError
from eitskin.recording import Recording
from witness import cases


def trial(kind: str, seed: int) -> dict:
    """Draw a case, diagnose its recording alone, and set the outcome beside the truth.

    The diagnosis is given the recording and nothing else; the truth is opened afterwards.
    """
    case = cases.draw(kind, seed)
    recorded = Recording(case.states, case.voltage, None, None, dict(case.metadata))
    began = time.perf_counter()
    found = diagnose.diagnose(recorded)
    seconds = time.perf_counter() - began
    said = diagnose.result(found, f"{kind} {seed}")
    query = Recording(case.query, None, None, None, dict(case.metadata))
    voltage, sd = diagnose.predict(found, query)
    plain, _ = diagnose.predict(found, query, found.before)
    error = voltage - case.query_clean
    return {
        "kind": kind,
        "seed": seed,
        "seconds": seconds,
        "level": case.level,
        "truth": case.effects,
        "scopes": case.scopes,
        "snr": case.snr,
        "snr_given_others": case.snr_given_others,
        "outside": case.outside,
        "true_gaps": true_gaps(found, case.effects, case.scopes),
        "said": said,
        "hidden": {
            "rmse_V": float(np.sqrt((error**2).mean())),
            "rmse_before_V": float(np.sqrt(((plain - case.query_clean) ** 2).mean())),
            "chi2_per_dof": float(1.0 + ((error / case.noise_V) ** 2).mean()),
            "within_90": float((np.abs(error) <= 1.6449 * sd).mean()),
        },
    }


def true_gaps(
    found: diagnose.Diagnosis, truth: list[dict], scopes: list[str]
) -> list[list[tuple[str, float]] | None]:
    """Gaps of each true effect to the other names, the nearest first, with the true set fitted;
    None where it cannot be fitted. Nothing of the diagnosis depends on it."""
    search, state = found.search, found.after
    wanted = [_candidate(search.candidates, *pair) for pair in zip(truth, scopes, strict=True)]
    if not wanted:
        return []
    own = found.gaps
    if {(c.name, c.sites) for c in wanted} != {(c.name, c.sites) for c in state.effects}:
        knobs = len(search.problem.model.calibrations)
        start = np.zeros(knobs + sum(c.size for c in wanted))
        try:
            state = search.state(fit(search.problem, wanted, start, polish=True))
            own = [gaps(search, state, i) for i in range(len(wanted))]
        except (InputError, np.linalg.LinAlgError):
            return [None] * len(wanted)
    of: dict[str, list[Gap]] = {
        c.name: listed for c, listed in zip(state.effects, own, strict=True)
    }
    return [[(g.rival, g.gap) for g in of[item["name"]]] for item in truth]


def _candidate(candidates: list[Candidate], item: dict, scope: str) -> Candidate:
    """The candidate that a true effect is, starting near its values."""
    kind = next((k for k in ("electrodes", "drives", "measures", "channels") if k in item), None)
    own = [c for c in candidates if c.name == item["name"]]
    if kind is not None:
        like = next(c for c in own if c.kind == kind)
        return replace(like, sites=tuple(item[kind]), scope="sparse")
    own = [c for c in own if c.scope in (scope, "")] or own
    given = item.get("parameters", {})

    def far(candidate: Candidate) -> float:
        return sum(abs(given.get(k, 0.0) - v) for k, v in candidate.start.items())

    return min(own, key=far)


def file_of(folder: Path, kind: str, seed: int) -> Path:
    """Where a trial's row lies."""
    return folder / f"{kind.replace(':', '-')}-{seed}.json"


def run(trials: list[tuple[str, int]], folder: Path) -> None:
    """Every trial that has no file in `folder` yet, each written as soon as it is done.

    A trial that breaks off leaves {kind, seed, failed: why}, for the score to count.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for kind, seed in trials:
        path = file_of(folder, kind, seed)
        if not path.exists():
            try:
                row = trial(kind, seed)
            except Exception as error:  # whatever it is, it is a result
                traceback.print_exc()
                row = {"kind": kind, "seed": seed, "failed": repr(error)}
            with atomic_path(path) as temporary:
                temporary.write_text(json.dumps(row, ensure_ascii=False) + "\n", "utf-8")
