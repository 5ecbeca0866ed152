"""What may be said of a diagnosed recording: its verdict, and how certain each effect is."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eitskin.diagnose.fitting.estimates import amounts, calibration, estimates, length_scale
from eitskin.diagnose.fitting.family_sizes import standing_out
from eitskin.diagnose.fitting.held_out import HeldOut
from eitskin.diagnose.fitting.readings import reserve_problem
from eitskin.diagnose.fitting.reserve import Reserve
from eitskin.diagnose.noise.whitening import Whitening
from eitskin.diagnose.search.gates import DISTINCT, FAMILY_COUNTS, OBSERVABLE, STANDS_OUT
from eitskin.diagnose.search.refits import reduced
from eitskin.diagnose.verdict import identities, words
from eitskin.diagnose.verdict.certainty import certainty, held_out_p, is_certain, least_gain
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.diagnose.verdict.families import families
from eitskin.diagnose.verdict.remainder import changes
from eitskin.diagnose.verdict.verdict import verdict
from eitskin.effects import EFFECTS, catalogue_names

OPTIONAL = ("scale", "families", "parts", "steps")  # keys that are left out where they are empty
PART_KEYS = ("verdict", "effects", "other", "fit")  # what diagnosis.json has of each part


@dataclass(frozen=True)
class Verdict:
    """diagnosis.json as an object, with the fields of the contract; `recording`, a name, is given
    where it is written. scale: the radius that stands for a size that nothing tells, empty
    elsewhere; parts, steps: empty unless the recording has steps in time; families: unless
    something is a little wrong at every site."""

    verdict: str
    calibration: dict[str, dict]
    scale: dict[str, float]
    noise_V: float
    noise: dict
    families: list[dict]
    effects: list[dict]
    other: dict
    unobservable: list[str]
    fit: dict
    parts: list[dict]
    steps: list[dict]

    def document(self, recording: str) -> dict[str, Any]:
        """The content of diagnosis.json for a recording of this name."""
        content = {"format": "eit-diagnosis", "version": 1, "recording": recording, **vars(self)}
        return {key: v for key, v in content.items() if v or key not in OPTIONAL}


def document(diagnosis: Diagnosis, recording: str) -> dict[str, Any]:
    """The content of diagnosis.json of a diagnosis, for a recording of this name."""
    return conclude(diagnosis).document(recording)


def conclude(diagnosis: Diagnosis) -> Verdict:
    """The verdict on a diagnosed recording: what the folds left out decide, and at last how the
    reserve is predicted."""
    explanation, noise = diagnosis.explanation, diagnosis.noise
    remainder = diagnosis.remainder
    entries = [_entry(diagnosis, i) for i in range(len(explanation.effects))]
    certainties, p_value = [e["certain"] for e in entries], held_out_p(diagnosis)
    everywhere = families(diagnosis)
    certainties += [True for family in everywhere if FAMILY_COUNTS.admits(family["share"])]
    summary = verdict(certainties, p_value, remainder.probability)
    fit = _fit(diagnosis)
    other = {
        "probability": remainder.probability,
        "electrodes": remainder.electrodes,
        "drives": remainder.drives,
        "measures": remainder.measures,
        "driver": remainder.driver,
        "law": remainder.law,
        "sentence": remainder.sentence,
    }
    part_content = dict(zip(PART_KEYS, (summary, entries, other, fit), strict=True))
    return Verdict(
        summary,
        calibration(explanation.fit),
        length_scale(explanation.fit),
        float(np.median(noise.white_sd)),
        _noise(diagnosis),
        everywhere,
        entries,
        other,
        unobservable(diagnosis),
        fit,
        [part | part_content if "told" in part else part for part in diagnosis.parts],
        [*diagnosis.steps],
    )


def _noise(diagnosis: Diagnosis) -> dict:
    """`noise` of diagnosis.json."""
    noise, recording = diagnosis.noise, diagnosis.recording
    unlabelled = [list(frames) for frames in diagnosis.unlabelled]
    return {
        "components": diagnosis.rig_errors,
        "loud_frames": recording.frames["frame"].iloc[[*noise.loud_frames]].tolist(),
        "jumps": [step["frame"] for step in diagnosis.steps],
        **({"unlabelled": unlabelled} if unlabelled else {}),
        **({"frames_each": diagnosis.frames_each} if diagnosis.frames_each > 1.0 else {}),
        "changes": changes(diagnosis.atlas),
        "spikes": {
            "readings": noise.spike_count,
            "share": noise.spike_count / max(int((~diagnosis.reserve_mask).sum()), 1),
        },
    }


def _fit(diagnosis: Diagnosis) -> dict:
    """`fit` of diagnosis.json; without `last` where nothing was reserved."""
    noise_whitening = diagnosis.noise_problem.whitening
    predictions = {
        "before": diagnosis.prediction_by(diagnosis.baseline),
        "after": diagnosis.prediction,
    }
    white = {key: _whitened_by(noise_whitening, held_out) for key, held_out in predictions.items()}
    mask = diagnosis.search.problem.whitening.mask
    fit = {"held_out": _scores(mask, predictions, white)}
    last = reserve_of(diagnosis)
    if last is not None:
        fit["last"] = _last(diagnosis, last)
    return fit


def reserve_of(diagnosis: Diagnosis) -> Reserve | None:
    """The readings that no decision read, in the covariance that was learned with the explanation;
    None where none were put aside."""
    problem = reserve_problem(
        diagnosis.noise_problem, diagnosis.recording, diagnosis.noise, diagnosis.reserve_mask
    )
    if problem is None:
        return None
    return Reserve(problem, diagnosis.explanation.error_sds, diagnosis.search.converter_step)


def _last(diagnosis: Diagnosis, reserve: Reserve) -> dict:
    """`fit.last` of diagnosis.json; before also in the covariance that was learned without an
    effect."""
    baseline, explanation = diagnosis.baseline, diagnosis.explanation
    fits = {"before": baseline.fit, "after": explanation.fit}
    scores = _scores(
        reserve.problem.whitening.mask,
        {key: reserve.prediction(fit) for key, fit in fits.items()},
        {key: reserve.noise_prediction(fit) for key, fit in fits.items()},
    )
    own = replace(reserve, error_sds=baseline.error_sds).prediction(baseline.fit)
    return scores | {"chi2_per_dof_before_own_sizes": own.chi2_per_dof}


def _scores(
    mask: np.ndarray, predictions: Mapping[str, HeldOut], white: Mapping[str, HeldOut]
) -> dict[str, Any]:
    """`fit.held_out` or `fit.last` by predictions before and after, and these against white noise
    alone; mask (N, M): of the readings."""
    return {
        "frames": int(mask.any(axis=1).sum()),
        **{f"chi2_per_dof_{key}": score.chi2_per_dof for key, score in predictions.items()},
        **{f"white_chi2_per_dof_{key}": score.chi2_per_dof for key, score in white.items()},
        **{f"rms_{key}_V": score.rms for key, score in predictions.items()},
    }


def _whitened_by(whitening: Whitening, prediction: HeldOut) -> HeldOut:
    """A prediction with its chi squared in another covariance."""
    return replace(prediction, chi2=(whitening(prediction.residual) ** 2).sum(axis=1))


def unobservable(diagnosis: Diagnosis) -> list[str]:
    """Names of the catalogue that the recording could not have shown at a typical size; a last
    resort is none of them, for it is not sought in a recording of the skin that is believed, nor is
    an effect that is not modelled on its outline."""
    skin = diagnosis.named_fit.problem.model.nominal_skin
    named = {c.name for c in diagnosis.explanation.effects}
    return sorted(
        name
        for name in catalogue_names()
        if name not in named
        and not EFFECTS[name].last_resort
        and EFFECTS[name].is_modelled(skin)
        and diagnosis.strengths.get(name, 0.0) < OBSERVABLE.threshold
    )


def _entry(diagnosis: Diagnosis, index: int) -> dict:
    """Effect `index` as diagnosis.json has it."""
    explanation = diagnosis.explanation
    candidate = explanation.effects[index]
    rivals, gaps = diagnosis.rivals[index], diagnosis.gaps[index]
    alternatives = [g.rival for g in gaps if not DISTINCT.admits(g.gap)]
    if gaps and not STANDS_OUT.admits(gaps[0].snr):
        # Gaps within so small a signature are noise: names fitted in its place come first.
        gains = {rival.name: rival.gain for rival in rivals}
        alternatives.sort(key=lambda name: gains.get(name, np.inf))
    gain, error = least_gain(diagnosis, index)
    reduced_set = reduced(diagnosis.search, explanation, index)
    entry: dict[str, Any] = {
        "name": candidate.name,
        "alternatives": alternatives,
        "scope": candidate.scope or "common",
        **{kind: [] for kind in ("electrodes", "drives", "measures", "channels")},
        "driver": candidate.effect.driver,
        "parameters": estimates(explanation.fit, index),
        "share": diagnosis.returned_share(diagnosis.prediction_by(reduced_set)),
        "evidence": {
            "elpd_gain": gain,
            "elpd_se": error,
            "p_value": explanation.p_value(candidate),
        },
        "gap": gaps[0].gap if gaps else None,
        "certain": is_certain(certainty(diagnosis, index)),
    }
    culprit = standing_out(explanation.fit, index)
    if culprit is not None:
        entry["stands_out"] = culprit.ratio
    if combined := amounts(explanation.fit, index, entry["parameters"]):
        entry["amounts"] = combined
    if candidate.kind is not None and candidate.scope != "common":
        entry[candidate.kind] = [int(site) for site in candidate.site_indices]
    sentences = [
        words.effect_sentence(entry, EFFECTS[candidate.name]),
        *identities.sentences(diagnosis.search, explanation, index, alternatives),
    ]
    entry["sentence"] = " ".join(sentences)
    return entry
