"""What a diagnosis found, as files: diagnosis.json, effects.yaml, predictions, evidence."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from eitskin import cores
from eitskin.atomic import atomic_path
from eitskin.data import parquet, recording
from eitskin.data.recording import Recording
from eitskin.diagnose.diagnosis import Diagnosis, predict
from eitskin.diagnose.fitting.estimates import amounts, calibration, estimates
from eitskin.diagnose.fitting.fit import whitened_anew
from eitskin.diagnose.fitting.held_out import HeldOut, held_out
from eitskin.diagnose.search.gates import CONFUSED
from eitskin.diagnose.search.state import State
from eitskin.diagnose.verdict import corrected, identities, validation, words
from eitskin.diagnose.verdict.experiment import propose
from eitskin.diagnose.verdict.gaps import OBSERVABLE
from eitskin.diagnose.verdict.verdict import LIKELY, acceptable, verdict
from eitskin.effects import EFFECTS, catalogue_names
from eitskin.errors import InputError

OF_A_PART = ("verdict", "effects", "other", "fit")  # what diagnosis.json has of each part


def result(found: Diagnosis, name: str) -> dict:
    """diagnosis.json of a diagnosis, as an object."""
    fits = {"before": found.before.fit, "after": found.after.fit}
    judged, noise, left = found.judged, found.noise, found.other
    held = {when: judged.by(fit) for when, fit in fits.items()}
    white = {when: judged.by_white(fit) for when, fit in fits.items()}
    named = found.search.named(found.after, found.after.fit)
    p = judged.p_value(named, noise.dof)
    entries = [_entry(found, i, acceptable(p)) for i in range(len(found.after.effects))]
    said: dict[str, Any] = {
        "format": "eit-diagnosis",
        "version": 1,
        "recording": name,
        "verdict": verdict([e["certain"] for e in entries], p, left.probability),
        "calibration": calibration(found.after.fit),
        "noise_V": float(np.median(noise.sd)),
        "noise": {
            "components": found.rig,
            "loud_frames": found.recorded.frames["frame"].iloc[[*noise.loud_frames]].tolist(),
            "jumps": [step["frame"] for step in found.steps],
            "spikes": {
                "readings": noise.spike_count,
                "share": noise.spike_count / found.recorded.readings.size,
            },
        },
        "effects": entries,
        "other": {
            "probability": left.probability,
            "electrodes": left.electrodes,
            "drives": left.drives,
            "measures": left.measures,
            "driver": left.driver,
            "law": left.law,
            "sentence": left.sentence,
        },
        "unobservable": unobservable(found),
        "fit": {
            "held_out": {
                "frames": int(judged.white.mask.any(axis=1).sum()),
                **{f"chi2_per_dof_{when}": one.chi2_per_dof for when, one in held.items()},
                **{f"white_chi2_per_dof_{when}": one.chi2_per_dof for when, one in white.items()},
                **{f"rms_{when}_V": one.rms for when, one in held.items()},
            }
        },
    }
    if found.steps:
        own = {key: said[key] for key in OF_A_PART}
        said["parts"] = [part | own if "told" in part else part for part in found.parts]
        said["steps"] = [*found.steps]
    return said


def unobservable(found: Diagnosis) -> list[str]:
    """Names of the catalogue that the recording could not have shown at a typical size; a last
    resort is none of them, for it is not sought in a recording of the skin that is believed."""
    there = {c.name for c in found.after.effects}
    return sorted(
        name
        for name in catalogue_names()
        if name not in there
        and not EFFECTS[name].last_resort
        and found.strengths.get(name, 0.0) < OBSERVABLE
    )


def _entry(found: Diagnosis, index: int, accepted: bool) -> dict:
    """One effect of diagnosis.json; accepted: whether the fit is as a whole. One that does not
    stand out from what has no name is no more than a candidate either, nor is one that what is
    left, where there probably is something, might tell from another name."""
    state, search = found.after, found.search
    candidate = state.effects[index]
    rivals = found.rivals[index]
    named = found.gaps[index]
    alternatives = [g.rival for g in named if g.gap < CONFUSED]
    stands_out = not named or named[0].snr >= CONFUSED
    left = found.other
    nearest = min((g.gap for g in named if g.gap >= CONFUSED), default=np.inf)
    told_apart = left.probability < LIKELY or nearest >= left.snr
    if not stands_out:  # gaps as small as it is tell nothing: those first that were fitted in place
        ahead = {rival.name: rival.gain for rival in rivals}
        alternatives.sort(key=lambda name: ahead.get(name, np.inf))
    judged = found.judged
    before, after = judged.by(found.before.fit), judged.by(state.fit)
    without = judged.by(search.less(state, index).fit)
    gain, error = min((rival.gain, rival.error) for rival in rivals)
    beyond = before.chi2.sum() - before.readings
    share = (without.chi2.sum() - after.chi2.sum()) / beyond if beyond > 0.0 else 0.0
    entry: dict[str, Any] = {
        "name": candidate.name,
        "alternatives": alternatives,
        "scope": candidate.scope or "common",
        **{kind: [] for kind in ("electrodes", "drives", "measures", "channels")},
        "driver": candidate.effect.driver,
        "parameters": estimates(state.fit, index),
        "share": float(np.clip(share, 0.0, 1.0)),
        "evidence": {"elpd_gain": gain, "elpd_se": error, "p_value": state.p_value(candidate)},
        "gap": named[0].gap if named else None,
        "certain": accepted and stands_out and told_apart,
    }
    if told := amounts(state.fit, index, entry["parameters"]):
        entry["amounts"] = told
    if candidate.kind is not None and candidate.scope != "common":
        entry[candidate.kind] = [int(site) for site in candidate.own_sites]
    said = words.finding(entry, EFFECTS[candidate.name])
    also = identities.readings(search, state, index, alternatives)
    entry["sentence"] = " ".join([said, *also])
    return entry


def write(
    found: Diagnosis,
    name: str,
    folder: str | Path,
    schema: str | Path,
    query_path: str | Path | None = None,
) -> dict:
    """Write a diagnosis into its folder: diagnosis.json, effects.yaml, predicted.parquet where a
    query is given, and the evidence that the report is made from. Returns what diagnosis.json
    says."""
    folder = Path(folder)
    said = result(found, name)
    validation.validate(said, schema, folder / "diagnosis.json")
    (folder / "evidence").mkdir(parents=True, exist_ok=True)
    if query_path is not None:
        voltage, sd = predict(found, read_query(query_path, found.recorded))
        _write_predicted(query_path, voltage, sd, folder / "predicted.parquet")
    _write_evidence(found, folder / "evidence")
    with atomic_path(folder / "effects.yaml") as path:
        text = corrected.text(found.after.fit, found.recorded, found.noise.sd, name)
        path.write_text(text, "utf-8")
    with atomic_path(folder / "diagnosis.json") as path:
        text = json.dumps(said, indent=2, ensure_ascii=False, allow_nan=False)
        path.write_text(text + "\n", "utf-8")
    return said


def read_query(path: str | Path, recorded: Recording) -> Recording:
    """The states and channels of a query of a recording, which may be others than the recording's;
    InputError where it is of a skin with another number of electrodes."""
    query = recording.read(path)
    count = recorded.n_electrodes
    known = query.skin.electrode_deg is not None
    if query.n_electrodes > count or (known and query.n_electrodes < count):
        place, found = "skin.electrode_deg" if known else "channels", query.n_electrodes
        raise InputError(path, place, f"{found} electrodes", f"the recording's {count}")
    return query


def _write_predicted(query: str | Path, voltage: np.ndarray, sd: np.ndarray, out: Path) -> None:
    table = parquet.read(query)
    for key, values in (("voltage_V", voltage), ("std_V", sd)):
        if key in table.column_names:
            table = table.drop_columns(key)
        table = table.append_column(key, parquet.lists(values))
    with atomic_path(out) as path:
        pq.write_table(table, path)


def _write_evidence(found: Diagnosis, folder: Path) -> None:
    before, after, problem = found.before.fit, found.after.fit, found.search.problem
    mask = problem.whitening.mask
    # What the rig's errors leave of both; a discrepancy would hide what has no name.
    plain = replace(before.problem, whitening=found.named.problem.whitening)
    frames = found.recorded.frames
    changes, changed_frame = _changes(found, mask)
    with atomic_path(folder / "residuals.npz") as path, path.open("wb") as file:
        np.savez_compressed(
            file,
            before=np.where(mask, plain.residual(before.theta, before.effects), np.nan),
            after=np.where(mask, found.named.residual, np.nan),
            noise_V=found.noise.sd,
            noise_source=np.array(found.noise.source),
            noise_dof=np.array(float(found.noise.dof)),
            channels=found.recorded.channels,
            held_out=found.aside.all(axis=1).astype(int),
            held_out_channels=found.aside.all(axis=0),
            press=problem.model.press,
            recorded_V=found.search.problem.recorded,
            before_V=found.search.as_reported(before),
            after_V=found.search.as_reported(after),
            changes=changes,
            changed_frame=changed_frame,
            **{
                key: frames[key].to_numpy(bool if key == "touch" else float)
                for key in ("time_s", "touch", "x_mm", "y_mm", "force_N", "probe_mm")
            },
        )
    rivals, experiment = cores.forked(lambda of: of(found), [_rivals, propose])
    tables = {
        "atlas_before": found.atlas_before,
        "atlas_after": found.atlas_after,
        "rivals": rivals,
        "identifiability": _identifiability(found),
        "search": pd.DataFrame(found.search.path),
    }
    for key, table in tables.items():
        with atomic_path(folder / f"{key}.csv") as path:
            table.to_csv(path, index=False)
    with atomic_path(folder / "experiment.json") as path:
        path.write_text(json.dumps(experiment, ensure_ascii=False) + "\n", "utf-8")


def _changes(found: Diagnosis, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(E, M): what each effect changes, in noise units, NaN where nothing is read, in the frame in
    which it changes most; (E,): the row of that frame. mask (N, M): what is read. NaN alone of an
    effect without which no skin has the rest."""
    fit, sd = found.after.fit, found.noise.sd
    changes, rows = np.zeros((len(fit.effects), mask.shape[1])), np.zeros(len(fit.effects), int)
    if not fit.effects:
        return changes, rows
    there = fit.problem.model.voltage(*fit.problem.split(fit.theta, fit.effects))
    for index in range(len(fit.effects)):
        try:
            change = np.where(mask, (there - fit.without(index)) / sd, np.nan)
        except InputError:
            changes[index] = np.nan
            continue
        rows[index] = np.argmax(np.nansum(change**2, axis=1))
        changes[index] = change[rows[index]]
    return changes, rows


def _rivals(found: Diagnosis) -> pd.DataFrame:
    """What each name in an effect's place costs on frames held out in turn, against the noise and
    the rig's errors of the state found, whatever each has learned for itself. First the state
    found, of no effect; a rival that has no physics where its touches were followed to is left
    out."""

    def held(state: State) -> HeldOut:
        return held_out(whitened_anew(state.fit, found.named.problem), found.search.fold)

    columns = ["effect", "instead", "chi2_per_dof", "elpd_difference", "gap"]
    if not found.after.effects:
        return pd.DataFrame(columns=columns)
    all_named = held(found.after)
    rows = [("", "", all_named.chi2_per_dof, 0.0, np.nan)]
    for candidate, gaps, rivals in zip(found.after.effects, found.gaps, found.rivals, strict=True):
        gap: dict[str | None, float] = {g.rival: g.gap for g in gaps}
        gap[None] = gaps[0].snr if gaps else np.nan
        for rival in rivals:
            try:
                left = held(rival.state)
            except InputError:
                continue
            elpd, own = left.gain(all_named)[0], gap.get(rival.name, np.nan)
            rows.append((candidate.name, rival.name or "nothing", left.chi2_per_dof, elpd, own))
    return pd.DataFrame(rows, columns=columns)


def _identifiability(found: Diagnosis) -> pd.DataFrame:
    nearest = {c.name: found.gaps[i][0] for i, c in enumerate(found.after.effects) if found.gaps[i]}
    hidden = set(unobservable(found))
    rows = []
    for name in sorted(catalogue_names()):
        gap = nearest.get(name)
        if EFFECTS[name].last_resort and gap is None:
            continue  # it was not sought
        snr = gap.snr if gap else found.strengths.get(name, 0.0)
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
