"""One recording with known truth: drawn, diagnosed, and what came of it kept as a row."""

import json
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np

from eitskin.data import check, importers, recording
from eitskin.data.recording import Recording
from eitskin.diagnose import diagnosis, parts
from eitskin.diagnose.fitting.harm import harm
from eitskin.diagnose.fitting.query import predict
from eitskin.diagnose.search.refits import as_reported
from eitskin.diagnose.verdict import conclusion
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.effects import catalogue_names, modules
from eitskin.errors import InputError
from eitskin.fingerprint import fingerprint
from proof import black_box, ledger, nulls, refit, rig_sizes
from proof.blocks import Trial
from proof.drawing import draw
from proof.intervals import band_numbers, rms
from proof.queries import QueryCase, check_findings
from witness.cases import Case
from witness.controls import Control

CATALOGUE = [*modules(catalogue_names()), *importers.modules()]
CODE = fingerprint("trials", CATALOGUE)[:12]  # of this process


def trial(kind: str, seed: int) -> dict:
    """Draw a case, diagnose its recording alone, and set the outcome beside the truth.

    The diagnosis is given the recording and nothing else; the truth is opened afterwards.
    """
    case: Case = draw(kind, seed)
    diagnosed, seconds = ledger.timed(partial(diagnosis.diagnose, case.recorded))
    case = _diagnosed_frames(case, diagnosed.recording)
    query = Recording(case.query, None, None, None, dict(case.metadata))
    voltage, sd = predict(diagnosed.explanation.fit, diagnosed.recording, query)
    plain, _ = predict(diagnosed.baseline.fit, diagnosed.recording, query)
    error = voltage - case.query_clean
    rmse = {"rmse_V": rms(error), "rmse_before_V": rms(plain - case.query_clean)}
    misfit = case.voltage - as_reported(diagnosed.search, diagnosed.baseline.fit)
    corrections = black_box.corrections(case.states, misfit, diagnosed.noise.sd, case.query, seed)
    for name, correction in corrections.items():
        rmse[f"rmse_{name}_V"] = rms(plain + correction - case.query_clean)
    return {
        **seconds,
        "level": case.level,
        "generator": case.world.generator.name,
        "truth": case.effects,
        "scopes": case.scopes,
        "snr": case.snr,
        "snr_given_others": case.snr_given_others,
        "outside": case.outside,
        "rig": [{"kind": error.kind, "size": error.size} for error in case.rig],
        "rig_sizes": rig_sizes.compared(
            case, diagnosed.search.problem.whitening.mask, diagnosed.noise, diagnosed.explanation
        ),
        "snr_left": refit.missing(diagnosed, case),
        "true_gaps": refit.true_gaps(diagnosed, case.effects, case.scopes),
        "said": conclusion.document(diagnosed, f"{kind} {seed}"),
        "other_p": diagnosed.remainder.p_value,
        "hidden": {**rmse, **band_numbers(error, sd, case.noise_V)},
    }


def _diagnosed_frames(case: Case, recording: Recording) -> Case:
    """A case without the frames that its diagnosed recording was left without."""
    rows = np.isin(case.states["frame"], recording.frames["frame"])
    states, true_states = (s[rows].reset_index(drop=True) for s in (case.states, case.true_states))
    return replace(
        case,
        states=states,
        true_states=true_states,
        clean=case.clean[rows],
        voltage=case.voltage[rows],
    )


def skin(kind: str, seed: int) -> dict:
    """The row of a skin with nothing left out, as of `nulls.trial`."""
    return nulls.trial(draw(kind, seed))


def query_trial(kind: str, seed: int) -> dict:
    """Draw a recording and its query, diagnose the recording alone, and set what is predicted of
    the query, after and before, beside its readings.

    What the tool refuses as a user would see it refused is `refused`; a real recording that is not
    there is `absent`, with a warning: the texts.
    """
    try:
        case: QueryCase = draw(kind, seed)
    except FileNotFoundError as error:
        warnings.warn(f"SKIPPED: {kind} {seed}: {error}", stacklevel=2)
        return {"absent": str(error)}
    return {"drawn": case.description, **_compared(case)}


def owner_trial(kind: str, seed: int) -> dict:
    """Draw a recording as owners have them, and do with it what `eitskin diagnose` does: check it,
    diagnose it where the check lets it pass, and predict readings that it never held.

    What the check calls unusable is `unusable`: (topic, sentence) of each error.
    """
    case: QueryCase = draw(kind, seed)
    assert case.truth is not None  # as of every owner's
    checked = check.check(case.recorded)
    row = {
        "drawn": case.description,
        "truth": asdict(case.truth),
        "check": check_findings(case.recorded, checked),
    }
    if not checked.ok:
        errors = [(finding.topic, finding.sentence) for finding in checked.of_severity(check.ERROR)]
        return {**row, "unusable": errors}
    return row | _compared(case)


def control_trial(kind: str, seed: int) -> dict:
    """Draw a control, check and diagnose it as `eitskin diagnose` does, and set what is said beside
    the truth. Raises InputError where the check calls it unusable."""
    control: Control = draw(kind, seed)
    checked = check.check(control.recorded)
    if not checked.ok:
        finding, *_ = checked.of_severity(check.ERROR)
        raise InputError(kind, finding.topic, finding.sentence, "a usable recording")
    diagnosed, seconds = ledger.timed(partial(parts.diagnose, control.recorded))
    return {
        **seconds,
        "level": control.level,
        "generator": control.generator,
        "truth": control.effects,
        "scopes": control.scopes,
        "snr": control.snr,
        "outside": None,
        "rig": [{"kind": error.kind, "size": error.size} for error in control.rig],
        "averaged": control.averaged,
        "common": control.common and asdict(control.common),
        "unlabelled": [asdict(stretch) for stretch in control.unlabelled],
        "true_gaps": refit.true_gaps(diagnosed, control.effects, control.scopes),
        "said": conclusion.document(diagnosed, f"{kind} {seed}"),
    }


def _compared(case: QueryCase) -> dict:
    """A recording diagnosed alone, and what is predicted of its query beside its readings; or the
    text with which it is `refused`."""

    def diagnose() -> Diagnosis:
        for recorded in (case.recorded, case.query):
            recording.validate(recorded, case.kind)
        return parts.diagnose(case.recorded)

    start = time.perf_counter()
    try:
        diagnosed, seconds = ledger.timed(diagnose)
        after, _ = predict(diagnosed.explanation.fit, diagnosed.recording, case.query)
        plain, _ = predict(diagnosed.baseline.fit, diagnosed.recording, case.query)
    except InputError as error:
        return {"seconds": time.perf_counter() - start, "refused": str(error)}
    return {
        **seconds,
        "said": conclusion.document(diagnosed, f"{case.kind} {case.seed}"),
        "hidden": harm(after, plain, case.readings, case.unit),
    }


def row(kind: str, seed: int) -> dict:
    """The row of a trial of any kind that `blocks.trials` has: {kind, seed, code, ...}."""
    sorts: dict[str, Callable[[str, int], dict]] = {
        "skin": skin,
        "query": query_trial,
        "owner": owner_trial,
        "control": control_trial,
    }
    trial_row = sorts.get(kind.partition(":")[0], trial)
    return {"kind": kind, "seed": seed, "code": CODE, **trial_row(kind, seed)}


def file_of(folder: Path, kind: str, seed: int) -> Path:
    """Where a trial's row lies."""
    return folder / f"{kind.replace(':', '-')}-{seed}.json"


def run(trials: list[Trial], folder: Path) -> None:
    """Every trial that has no file in `folder` yet, each written as soon as it is done.

    A trial that breaks off leaves {kind, seed, failed: why}, for the score to count. A row says by
    its `code` what drew and diagnosed it; it is made again where that has changed, or where a real
    recording was absent.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for kind, seed in trials:
        path = file_of(folder, kind, seed)
        if not (path.exists() and _is_current(json.loads(path.read_text("utf-8")))):
            head = {"kind": kind, "seed": seed, "code": CODE}
            ledger.write(path, head | ledger.outcome(partial(row, kind, seed)))


def _is_current(row: dict) -> bool:
    return row["code"] == CODE and "absent" not in row
