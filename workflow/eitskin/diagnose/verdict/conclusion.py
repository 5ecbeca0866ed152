"""What may be said of a diagnosed recording: its verdict, and how certain each effect is."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from eitskin.diagnose.fitting.estimates import amounts, calibration, estimates
from eitskin.diagnose.search.gates import (
    ACCEPTABLE,
    DISTINCT,
    NOTHING_UNNAMED,
    OBSERVABLE,
    REMAINDER,
    STANDS_OUT,
    Gate,
)
from eitskin.diagnose.search.refits import reduced, without_discrepancy
from eitskin.diagnose.verdict import identities, words
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.diagnose.verdict.verdict import verdict
from eitskin.effects import EFFECTS, catalogue_names

NO_EVIDENCE = "No evidence that"  # of the atlas, on a row that is not significant
PART_KEYS = ("verdict", "effects", "other", "fit")  # what diagnosis.json has of each part


@dataclass(frozen=True)
class Verdict:
    """diagnosis.json as an object, with the fields of the contract; `recording`, a name, is given
    where it is written. parts, steps: empty unless the recording has steps in time."""

    verdict: str
    calibration: dict[str, dict]
    noise_V: float
    noise: dict
    effects: list[dict]
    other: dict
    unobservable: list[str]
    fit: dict
    parts: list[dict]
    steps: list[dict]

    def document(self, recording: str) -> dict[str, Any]:
        """The content of diagnosis.json for a recording of this name."""
        content = {"format": "eit-diagnosis", "version": 1, "recording": recording, **vars(self)}
        return {key: v for key, v in content.items() if v or key not in ("parts", "steps")}


def document(diagnosis: Diagnosis, recording: str) -> dict[str, Any]:
    """The content of diagnosis.json of a diagnosis, for a recording of this name."""
    return conclude(diagnosis).document(recording)


def conclude(diagnosis: Diagnosis) -> Verdict:
    """The verdict on a diagnosed recording.

    Chi squared before and after are of the reserve, both in the covariance of the fit after.
    """
    explanation, noise = diagnosis.explanation, diagnosis.noise
    remainder = diagnosis.remainder
    p_value = held_out_p(diagnosis)
    entries = [_entry(diagnosis, i, p_value) for i in range(len(explanation.effects))]
    fit = _held_out(diagnosis)
    summary = verdict([e["certain"] for e in entries], p_value, remainder.probability)
    has_pattern = not (remainder.sentence or "").startswith(NO_EVIDENCE)
    other = {
        "probability": remainder.probability,
        "electrodes": remainder.electrodes,
        "drives": remainder.drives,
        "measures": remainder.measures,
        "driver": remainder.driver if has_pattern else None,
        "law": remainder.law if has_pattern else None,
        "sentence": remainder.sentence if has_pattern else words.NO_PATTERN,
    }
    part_content = dict(zip(PART_KEYS, (summary, entries, other, fit), strict=True))
    return Verdict(
        summary,
        calibration(explanation.fit),
        float(np.median(noise.sd)),
        _noise(diagnosis),
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
        "spikes": {
            "readings": noise.spike_count,
            "share": noise.spike_count / recording.readings.size,
        },
    }


def _held_out(diagnosis: Diagnosis) -> dict:
    """`fit` of diagnosis.json."""
    reserve = diagnosis.reserve
    fits = {"before": diagnosis.baseline.fit, "after": diagnosis.explanation.fit}
    scores = {key: reserve.prediction(fit) for key, fit in fits.items()}
    white_scores = {key: reserve.noise_prediction(fit) for key, fit in fits.items()}
    return {
        "held_out": {
            "frames": int(reserve.noise_whitening.mask.any(axis=1).sum()),
            **{f"chi2_per_dof_{key}": score.chi2_per_dof for key, score in scores.items()},
            **{
                f"white_chi2_per_dof_{key}": score.chi2_per_dof
                for key, score in white_scores.items()
            },
            **{f"rms_{key}_V": score.rms for key, score in scores.items()},
        }
    }


def unobservable(diagnosis: Diagnosis) -> list[str]:
    """Names of the catalogue that the recording could not have shown at a typical size; a last
    resort is none of them, for it is not sought in a recording of the skin that is believed."""
    named = {c.name for c in diagnosis.explanation.effects}
    return sorted(
        name
        for name in catalogue_names()
        if name not in named
        and not EFFECTS[name].last_resort
        and diagnosis.strengths.get(name, 0.0) < OBSERVABLE.threshold
    )


def _entry(diagnosis: Diagnosis, index: int, p_value: float) -> dict:
    """Effect `index` as diagnosis.json has it; p_value: of the reserve's chi squared."""
    explanation = diagnosis.explanation
    candidate = explanation.effects[index]
    rivals, gaps = diagnosis.rivals[index], diagnosis.gaps[index]
    alternatives = [g.rival for g in gaps if not DISTINCT.admits(g.gap)]
    if gaps and not STANDS_OUT.admits(gaps[0].snr):
        # Gaps within so small a signature are noise: names fitted in its place come first.
        gains = {rival.name: rival.gain for rival in rivals}
        alternatives.sort(key=lambda name: gains.get(name, np.inf))
    gain, error = min((rival.gain, rival.error) for rival in rivals)
    entry: dict[str, Any] = {
        "name": candidate.name,
        "alternatives": alternatives,
        "scope": candidate.scope or "common",
        **{kind: [] for kind in ("electrodes", "drives", "measures", "channels")},
        "driver": candidate.effect.driver,
        "parameters": estimates(explanation.fit, index),
        "share": _share(diagnosis, index),
        "evidence": {
            "elpd_gain": gain,
            "elpd_se": error,
            "p_value": explanation.p_value(candidate),
        },
        "gap": gaps[0].gap if gaps else None,
        "certain": all(gate.admits(value) for gate, value in certainty(diagnosis, index, p_value)),
    }
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


def certainty(diagnosis: Diagnosis, index: int, p_value: float) -> list[tuple[Gate, float]]:
    """The gates that effect `index` must pass to be certain, and its values: the fit as a whole is
    acceptable, the effect stands out from what has no name, and the remainder, where there probably
    is one, could not distinguish it from another name."""
    gaps, remainder = diagnosis.gaps[index], diagnosis.remainder
    values = [(ACCEPTABLE, p_value), (STANDS_OUT, gaps[0].snr if gaps else np.inf)]
    if not NOTHING_UNNAMED.admits(remainder.probability):
        nearest = min((g.gap for g in gaps if DISTINCT.admits(g.gap)), default=np.inf)
        values.append((REMAINDER, nearest - remainder.snr))
    return values


def held_out_p(diagnosis: Diagnosis) -> float:
    """P-value of the reserve's chi squared, nothing without a name in its covariance."""
    explanation = diagnosis.explanation
    named_fit = without_discrepancy(explanation, explanation.fit)
    return diagnosis.reserve.p_value(named_fit, diagnosis.noise.dof)


def _share(diagnosis: Diagnosis, index: int) -> float:
    """Share of the reserve's excess chi squared that returns without an effect, of 0 to 1."""
    reserve, explanation = diagnosis.reserve, diagnosis.explanation
    chi2_baseline, chi2_explained, chi2_reduced = (
        reserve.prediction(fit).chi2.sum()
        for fit in (
            diagnosis.baseline.fit,
            explanation.fit,
            reduced(diagnosis.search, explanation, index).fit,
        )
    )
    excess = chi2_baseline - reserve.prediction(diagnosis.baseline.fit).reading_count
    share = (chi2_reduced - chi2_explained) / excess if excess > 0.0 else 0.0
    return float(np.clip(share, 0.0, 1.0))
