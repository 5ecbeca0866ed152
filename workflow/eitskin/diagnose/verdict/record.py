"""All that is written of a diagnosis: its document, its simulator, predictions, evidence."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from eitskin import cores
from eitskin.data import recording as recordings
from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.query import predict
from eitskin.diagnose.search.journal import Journal
from eitskin.diagnose.search.refits import as_reported
from eitskin.diagnose.verdict import corrected
from eitskin.diagnose.verdict.certainty import certainty
from eitskin.diagnose.verdict.conclusion import document, reserve_of, unobservable
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.diagnose.verdict.experiment import propose
from eitskin.effects import EFFECTS, catalogue_names
from eitskin.errors import InputError


@dataclass(frozen=True)
class Record:
    """A diagnosis as it is written.

    document: the content of diagnosis.json; simulator: the text of effects.yaml; prediction: of a
    query, voltages and their standard deviations (N, M), None without a query; arrays, tables and
    experiment: the evidence that the report is made from.
    """

    document: dict
    simulator: str
    prediction: tuple[np.ndarray, np.ndarray] | None
    arrays: dict[str, np.ndarray]
    tables: dict[str, pd.DataFrame]
    experiment: dict


def record(diagnosis: Diagnosis, name: str, query: Recording | None = None) -> Record:
    """The record of a diagnosis, for a recording of this name; query: to be predicted. Raises
    InputError for a query with touches of unknown state."""
    with threadpool_limits(1, user_api="blas"):  # as in `diagnosis.diagnose`
        return _record(diagnosis, name, query)


def _record(diagnosis: Diagnosis, name: str, query: Recording | None) -> Record:
    fitted = diagnosis.explanation.fit
    content = document(diagnosis, name)
    prediction = None if query is None else predict(fitted, diagnosis.recording, query)
    arrays = _arrays(diagnosis)
    rivals, experiment = cores.forked(lambda part: part(diagnosis), [_rivals, propose])
    tables = {
        "atlas_before": diagnosis.baseline_atlas,
        "atlas_after": diagnosis.atlas,
        "rivals": rivals,
        "identifiability": _identifiability(diagnosis),
        "search": pd.DataFrame(diagnosis.search.journal.steps),
        "decisions": _decisions(diagnosis),
    }
    frame_sd = diagnosis.noise.sd * np.sqrt(diagnosis.frames_each)
    simulator = corrected.yaml_text(fitted, diagnosis.recording, frame_sd, name)
    return Record(content, simulator, prediction, arrays, tables, experiment)


def _decisions(diagnosis: Diagnosis) -> pd.DataFrame:
    """The decisions of the search, then those on the certainty of each effect, one a row."""
    explanation = diagnosis.explanation
    journal = Journal(decisions=[*diagnosis.search.journal.decisions])
    for index, effect in enumerate(explanation.effects):
        for item in certainty(diagnosis, index):
            for gate, value, place in [j for j in item if j.passed][:1] or item:
                journal.judge(gate, value, effect, explanation, place)
    return journal.table()


def read_query(path: str | Path, recording: Recording) -> Recording:
    """The states and channels of a query of a recording, which may be others than the recording's;
    InputError where it is of a skin with another number of electrodes, and where it is touched and
    no length tells the size of the recording's."""
    query = recordings.read(path)
    count = recording.n_electrodes
    is_stated = query.skin.electrode_deg is not None
    if query.n_electrodes > count or (is_stated and query.n_electrodes < count):
        place, count_of_query = (
            "skin.electrode_deg" if is_stated else "channels",
            query.n_electrodes,
        )
        raise InputError(path, place, f"{count_of_query} electrodes", f"the recording's {count}")
    if query.frames["touch"].any() and not recordings.has_lengths(recording):
        expected = "a length of the recording's skin, as skin.radius_mm: nothing tells its size"
        raise InputError(path, "frames", "touches at places in mm", expected)
    return query


def _arrays(diagnosis: Diagnosis) -> dict[str, np.ndarray]:
    """The arrays of residuals.npz: N frames, M channels, E effects."""
    baseline, fitted = diagnosis.baseline.fit, diagnosis.explanation.fit
    search, noise = diagnosis.search, diagnosis.noise
    mask = search.problem.whitening.mask
    # In the covariance of the rig's errors alone: a discrepancy would hide what has no name.
    problem = replace(baseline.problem, whitening=diagnosis.named_fit.problem.whitening)
    frames = diagnosis.recording.frames
    changes, changed_frame = _changes(diagnosis, mask)
    reserve = reserve_of(diagnosis)
    last = {f"last_{key}_V": np.full(mask.shape, np.nan) for key in ("before", "after")}
    if reserve is not None:
        for key, fit in (("before", baseline), ("after", fitted)):
            error = reserve.noise_prediction(fit).residual
            last[f"last_{key}_V"] = np.where(reserve.problem.whitening.mask, error, np.nan)
    return {
        "before": np.where(mask, problem.residual(baseline.theta, baseline.effects), np.nan),
        "after": np.where(mask, diagnosis.named_fit.residual, np.nan),
        "noise_V": noise.sd,
        "noise_source": np.array(noise.source),
        "noise_dof": np.array(float(noise.dof)),
        "channels": diagnosis.recording.channels,
        "last": diagnosis.reserve_mask.all(axis=1).astype(int),
        "last_channels": diagnosis.reserve_mask.all(axis=0),
        **last,
        "press": search.problem.model.press,
        "recorded_V": search.problem.readings,
        "before_V": as_reported(search, baseline),
        "after_V": as_reported(search, fitted),
        "changes": changes,
        "changed_frame": changed_frame,
        **{
            key: frames[key].to_numpy(bool if key == "touch" else float)
            for key in ("time_s", "touch", "x_mm", "y_mm", "force_N", "probe_mm")
        },
    }


def _changes(diagnosis: Diagnosis, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(E, M): what each effect changes, in noise units, NaN where nothing is read, in the frame in
    which it changes most; (E,): the row of that frame. mask (N, M): what is read. NaN throughout of
    an effect without which the other effects have no skin."""
    fit, sd = diagnosis.explanation.fit, diagnosis.noise.sd
    changes, rows = np.zeros((len(fit.effects), mask.shape[1])), np.zeros(len(fit.effects), int)
    if not fit.effects:
        return changes, rows
    simulated = fit.problem.model.voltage(*fit.problem.split(fit.theta, fit.effects))
    for index in range(len(fit.effects)):
        try:
            change = np.where(mask, (simulated - fit.voltage_without(index)) / sd, np.nan)
        except InputError:
            changes[index] = np.nan
            continue
        rows[index] = np.argmax(np.nansum(change**2, axis=1))
        changes[index] = change[rows[index]]
    return changes, rows


def _rivals(diagnosis: Diagnosis) -> pd.DataFrame:
    """What each name in an effect's place costs on frames held out in turn, all in the covariance
    of the explanation. The first row is that of the explanation, with no effect; a rival that has
    no physics where its touches were displaced to has no row."""

    columns = ["effect", "instead", "chi2_per_dof", "elpd_difference", "gap"]
    if not diagnosis.explanation.effects:
        return pd.DataFrame(columns=columns)
    all_named = diagnosis.prediction
    rows = [("", "", all_named.chi2_per_dof, 0.0, np.nan)]
    for candidate, gaps, rivals in zip(
        diagnosis.explanation.effects, diagnosis.gaps, diagnosis.rivals, strict=True
    ):
        gap_to: dict[str | None, float] = {g.rival: g.gap for g in gaps}
        gap_to[None] = gaps[0].snr if gaps else np.nan
        for rival in rivals:
            try:
                score = diagnosis.prediction_by(rival.explanation)
            except InputError:
                continue
            elpd, gap = score.gain(all_named)[0], gap_to.get(rival.name, np.nan)
            rows.append((candidate.name, rival.name or "nothing", score.chi2_per_dof, elpd, gap))
    return pd.DataFrame(rows, columns=columns)


def _identifiability(diagnosis: Diagnosis) -> pd.DataFrame:
    nearest = {
        c.name: diagnosis.gaps[i][0]
        for i, c in enumerate(diagnosis.explanation.effects)
        if diagnosis.gaps[i]
    }
    hidden = set(unobservable(diagnosis))
    rows = []
    for name in sorted(catalogue_names()):
        gap = nearest.get(name)
        if EFFECTS[name].last_resort and gap is None:
            continue  # it was not sought
        snr = gap.snr if gap else diagnosis.strengths.get(name, 0.0)
        rows.append(
            {
                "name": name,
                "snr": snr if np.isfinite(snr) else np.nan,
                "nearest": gap.rival if gap else "",
                "gap": gap.gap if gap else np.nan,
                "observable": name not in hidden,
                "experiment": EFFECTS[name].shown_by if name in hidden else "",
            }
        )
    return pd.DataFrame(rows)
