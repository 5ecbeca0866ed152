"""One recording with known truth: drawn, diagnosed, and what came of it kept as a row."""

import json
import math
import time
import traceback
import warnings
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from calibration import asked, black_box, nulls, owners, rig_sizes
from calibration.intervals import rms
from eitskin import cores
from eitskin.atomic import atomic_path
from eitskin.data import check, importers, recording
from eitskin.data.recording import Recording
from eitskin.diagnose import apart, diagnosis
from eitskin.diagnose.fitting.candidates import Candidate, gross
from eitskin.diagnose.fitting.estimates import NORMAL_90
from eitskin.diagnose.fitting.fit import Fit, fit
from eitskin.diagnose.fitting.harm import harm
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.search.state import State
from eitskin.diagnose.verdict import result
from eitskin.diagnose.verdict.gaps import Gap, gaps
from eitskin.effects import catalogue_names, modules
from eitskin.errors import InputError
from eitskin.fingerprint import fingerprint
from witness import cases, owned

FOUND = [*modules(catalogue_names()), *importers.modules()]
CODE = fingerprint("trials", FOUND)[:12]  # of this process


def trial(kind: str, seed: int) -> dict:
    """Draw a case, diagnose its recording alone, and set the outcome beside the truth.

    The diagnosis is given the recording and nothing else; the truth is opened afterwards.
    """
    case = cases.draw(kind, seed)
    recorded = case.recorded
    began = time.perf_counter(), cores.seconds()
    found = diagnosis.diagnose(recorded)
    ended = time.perf_counter(), cores.seconds()
    said = result.result(found, f"{kind} {seed}")
    query = Recording(case.query, None, None, None, dict(case.metadata))
    voltage, sd = diagnosis.predict(found, query)
    plain, _ = diagnosis.predict(found, query, found.before)
    error = voltage - case.query_clean
    rmse = {"rmse_V": rms(error), "rmse_before_V": rms(plain - case.query_clean)}
    misfit = case.voltage - found.search.as_reported(found.before.fit)
    learned = black_box.corrections(case.states, misfit, found.noise.sd, case.query, seed)
    for name, added in learned.items():
        rmse[f"rmse_{name}_V"] = rms(plain + added - case.query_clean)
    return {
        "kind": kind,
        "seed": seed,
        "code": CODE,
        "seconds": ended[0] - began[0],
        "cpu_seconds": ended[1] - began[1],
        "level": case.level,
        "truth": case.effects,
        "scopes": case.scopes,
        "snr": case.snr,
        "snr_given_others": case.snr_given_others,
        "outside": case.outside,
        "rig": [{"kind": error.kind, "size": error.size} for error in case.rig],
        "rig_sizes": rig_sizes.compared(
            case, found.search.problem.whitening.mask, found.noise, found.after
        ),
        "snr_left": missing(found, case),
        "true_gaps": true_gaps(found, case.effects, case.scopes),
        "said": said,
        "other_p": found.other.p_value,
        "hidden": {
            **rmse,
            "chi2_per_dof": float(1.0 + ((error / case.noise_V) ** 2).mean()),
            "within_90": float((np.abs(error) <= NORMAL_90 * sd).mean()),
        },
    }


def skin(kind: str, seed: int) -> dict:
    """The row of a skin with nothing left out, as of `nulls.trial`."""
    return {"kind": kind, "seed": seed, "code": CODE, **nulls.trial(seed)}


def query_trial(kind: str, seed: int) -> dict:
    """Draw a recording and its query, diagnose the recording alone, and set what is predicted of
    the query, after and before, beside what was there.

    What the tool refuses as a user would see it refused is `refused`; a real recording that is not
    there is `absent`, with a warning: the texts.
    """
    head = {"kind": kind, "seed": seed, "code": CODE}
    try:
        drawn = asked.draw(kind, seed)
    except FileNotFoundError as error:
        warnings.warn(f"SKIPPED: {kind} {seed}: {error}", stacklevel=2)
        return {**head, "absent": str(error)}
    head["drawn"] = drawn.drawn
    return head | _compared(kind, seed, drawn)


def _compared(kind: str, seed: int, drawn: asked.Asked) -> dict:
    """A recording diagnosed alone, and what is predicted of its query beside what was there; or
    the text with which it is `refused`."""
    began = time.perf_counter(), cores.seconds()
    try:
        for one in (drawn.recorded, drawn.query):
            recording.validate(one, kind)
        found = apart.diagnose(drawn.recorded)
        ended = time.perf_counter(), cores.seconds()
        after, _ = diagnosis.predict(found, drawn.query)
        before, _ = diagnosis.predict(found, drawn.query, found.before)
    except InputError as error:
        return {"seconds": time.perf_counter() - began[0], "refused": str(error)}
    return {
        "seconds": ended[0] - began[0],
        "cpu_seconds": ended[1] - began[1],
        "said": result.result(found, f"{kind} {seed}"),
        "hidden": harm(after, before, drawn.there, drawn.unit),
    }


def owner_trial(kind: str, seed: int) -> dict:
    """Draw a recording as owners have them, and do with it what `eitskin diagnose` does: check it,
    diagnose it where the check lets it pass, and predict readings that it never held.

    What the check calls unusable is `unusable`: (topic, sentence) of each error.
    """
    owner = owned.draw(kind, seed)
    drawn = owners.asked_of(owner)
    checked = check.check(drawn.recorded)
    row = {
        "kind": kind,
        "seed": seed,
        "code": CODE,
        "drawn": drawn.drawn,
        "truth": asdict(owner.truth),
        "check": owners.said_by_check(drawn.recorded, checked),
    }
    if not checked.ok:
        errors = checked.of_severity(check.ERROR)
        return {**row, "unusable": [(one.topic, one.sentence) for one in errors]}
    return row | _compared(kind, seed, drawn)


def row(kind: str, seed: int) -> dict:
    """The row of a trial of any kind that `blocks.trials` has."""
    of = {"skin": skin, "query": query_trial, "owner": owner_trial}
    return of.get(kind.partition(":")[0], trial)(kind, seed)


def missing(found: diagnosis.Diagnosis, case: cases.Case) -> float:
    """`snr_left` of a case beyond what was found of it, both where its touches truly were: that a
    rig has them elsewhere is no physics left out."""
    there = Recording(case.true_states, None, None, None, dict(case.metadata))
    simulated, _ = diagnosis.predict(found, there)
    return snr_left(found.after.fit, simulated, case.clean)


def snr_left(fitted: Fit, simulated: np.ndarray, clean: np.ndarray) -> float:
    """Length, in noise units, of what noise-free readings (N, M) V have beyond those that a fit
    has for them, (N, M) V, all that was fitted projected out."""
    left = fitted.problem.whitening(clean - simulated).ravel()
    slopes = fitted.jacobian.reshape(len(fitted.theta), -1).T
    return float(np.linalg.norm(left - slopes @ np.linalg.lstsq(slopes, left)[0]))


def true_gaps(
    found: diagnosis.Diagnosis, truth: list[dict], scopes: list[str]
) -> list[list[tuple[str, float]] | None]:
    """Gaps of each true effect to the other names, the nearest first, with the true set fitted;
    None where it cannot be fitted. Nothing of the diagnosis depends on it, nor does it end where
    that was cut short; but gaps are those of the linearised model then."""
    return gaps_about(found.search, found.before, found.after, found.gaps, truth, scopes)


def gaps_about(
    search: Search,
    before: State,
    state: State,
    own: list[list[Gap]],
    truth: list[dict],
    scopes: list[str],
) -> list[list[tuple[str, float]] | None]:
    """As `true_gaps`, of a search: the states without effects and after it, with the gaps of the
    latter's effects."""
    wanted = [candidate_of(search.candidates, *pair) for pair in zip(truth, scopes, strict=True)]
    if not wanted:
        return []
    if {(c.name, c.sites) for c in wanted} != {(c.name, c.sites) for c in state.effects}:
        fitted = with_all(replace(search, share=math.inf), before, wanted)
        if fitted is None:
            return [None] * len(wanted)
        state = fitted
        own = [gaps(search, state, i) for i in range(len(wanted))]
    of: dict[str, list[Gap]] = {
        c.name: listed for c, listed in zip(state.effects, own, strict=True)
    }
    return [[(g.rival, g.gap) for g in of[item["name"]]] for item in truth]


def with_all(search: Search, state: State, wanted: list[Candidate]) -> State | None:
    """`state` with candidates fitted one after the other, the gross faults first; None where one
    cannot be."""
    for candidate in sorted(wanted, key=lambda c: not gross(c)):
        fitted = search.with_effect(state, candidate)
        if fitted is None:
            return None
        state = fitted
    return search.state(fit(search.problem, state.effects, state.fit.theta, polish=True))


def candidate_of(candidates: list[Candidate], item: dict, scope: str) -> Candidate:
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

    nearest = min(own, key=far)
    neutral, skin = nearest.effect.neutral, nearest.skin
    needed = {k: v for k, v in given.items() if v is not None and neutral(k, skin) is None}
    return replace(nearest, start={**needed, **nearest.start})


def file_of(folder: Path, kind: str, seed: int) -> Path:
    """Where a trial's row lies."""
    return folder / f"{kind.replace(':', '-')}-{seed}.json"


def run(trials: list[tuple[str, int]], folder: Path) -> None:
    """Every trial that has no file in `folder` yet, each written as soon as it is done.

    A trial that breaks off leaves {kind, seed, failed: why}, for the score to count. A row says by
    its `code` what drew and diagnosed it; it is made again where that has changed, or where a real
    recording was absent.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for kind, seed in trials:
        path = file_of(folder, kind, seed)
        if not (path.exists() and _current(json.loads(path.read_text("utf-8")))):
            try:
                made = row(kind, seed)
            except (MemoryError, OSError):  # of the machine, not of the recording
                raise
            except Exception as error:  # whatever it is, it is a result
                traceback.print_exc()
                made = {"kind": kind, "seed": seed, "code": CODE, "failed": repr(error)}
            with atomic_path(path) as temporary:
                temporary.write_text(json.dumps(made, ensure_ascii=False) + "\n", "utf-8")


def _current(row: dict) -> bool:
    return row["code"] == CODE and "absent" not in row
