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
)
from eitskin.diagnose.search.refits import reduced, without_discrepancy
from eitskin.diagnose.verdict import identities, words
from eitskin.diagnose.verdict.diagnosis import Diagnosis
from eitskin.diagnose.verdict.verdict import verdict
from eitskin.effects import EFFECTS, catalogue_names

OF_A_PART = ("verdict", "effects", "other", "fit")  # what diagnosis.json has of each part


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

    Chi squared before and after are of the reserve, both in the covariance of the fit after. The
    gates of certainty are recorded in the journal of the search.
    """
    reserve, noise, other = diagnosis.reserve, diagnosis.noise, diagnosis.other
    named = without_discrepancy(diagnosis.after, diagnosis.after.fit)
    p_value = reserve.p_value(named, noise.dof)
    entries = [_entry(diagnosis, i, p_value) for i in range(len(diagnosis.after.effects))]
    fit = _held_out(diagnosis)
    summary = verdict([e["certain"] for e in entries], p_value, other.probability)
    remainder = {
        "probability": other.probability,
        "electrodes": other.electrodes,
        "drives": other.drives,
        "measures": other.measures,
        "driver": other.driver,
        "law": other.law,
        "sentence": other.sentence,
    }
    of_part = dict(zip(OF_A_PART, (summary, entries, remainder, fit), strict=True))
    return Verdict(
        summary,
        calibration(diagnosis.after.fit),
        float(np.median(noise.sd)),
        _noise(diagnosis),
        entries,
        remainder,
        unobservable(diagnosis),
        fit,
        [part | of_part if "told" in part else part for part in diagnosis.parts],
        [*diagnosis.steps],
    )


def _noise(diagnosis: Diagnosis) -> dict:
    """`noise` of diagnosis.json."""
    noise, recording = diagnosis.noise, diagnosis.recording
    return {
        "components": diagnosis.rig,
        "loud_frames": recording.frames["frame"].iloc[[*noise.loud_frames]].tolist(),
        "jumps": [step["frame"] for step in diagnosis.steps],
        "spikes": {
            "readings": noise.spike_count,
            "share": noise.spike_count / recording.readings.size,
        },
    }


def _held_out(diagnosis: Diagnosis) -> dict:
    """`fit` of diagnosis.json."""
    reserve = diagnosis.reserve
    fits = {"before": diagnosis.before.fit, "after": diagnosis.after.fit}
    predicted = {when: reserve.predicted(fit) for when, fit in fits.items()}
    white = {when: reserve.predicted_in_white(fit) for when, fit in fits.items()}
    return {
        "held_out": {
            "frames": int(reserve.white.mask.any(axis=1).sum()),
            **{f"chi2_per_dof_{when}": one.chi2_per_dof for when, one in predicted.items()},
            **{f"white_chi2_per_dof_{when}": one.chi2_per_dof for when, one in white.items()},
            **{f"rms_{when}_V": one.rms for when, one in predicted.items()},
        }
    }


def unobservable(diagnosis: Diagnosis) -> list[str]:
    """Names of the catalogue that the recording could not have shown at a typical size; a last
    resort is none of them, for it is not sought in a recording of the skin that is believed."""
    named = {c.name for c in diagnosis.after.effects}
    return sorted(
        name
        for name in catalogue_names()
        if name not in named
        and not EFFECTS[name].last_resort
        and diagnosis.strengths.get(name, 0.0) < OBSERVABLE.threshold
    )


def _entry(diagnosis: Diagnosis, index: int, p_value: float) -> dict:
    """Effect `index` as diagnosis.json has it; p_value: of the reserve's chi squared."""
    after = diagnosis.after
    candidate = after.effects[index]
    rivals, gaps = diagnosis.rivals[index], diagnosis.gaps[index]
    alternatives = [g.rival for g in gaps if not DISTINCT.admits(g.gap)]
    if gaps and not STANDS_OUT.admits(gaps[0].snr):
        # Gaps as small as it is tell nothing: those first that were fitted in its place.
        gains = {rival.name: rival.gain for rival in rivals}
        alternatives.sort(key=lambda name: gains.get(name, np.inf))
    gain, error = min((rival.gain, rival.error) for rival in rivals)
    entry: dict[str, Any] = {
        "name": candidate.name,
        "alternatives": alternatives,
        "scope": candidate.scope or "common",
        **{kind: [] for kind in ("electrodes", "drives", "measures", "channels")},
        "driver": candidate.effect.driver,
        "parameters": estimates(after.fit, index),
        "share": _share(diagnosis, index),
        "evidence": {"elpd_gain": gain, "elpd_se": error, "p_value": after.p_value(candidate)},
        "gap": gaps[0].gap if gaps else None,
        "certain": _is_certain(diagnosis, index, p_value),
    }
    if combined := amounts(after.fit, index, entry["parameters"]):
        entry["amounts"] = combined
    if candidate.kind is not None and candidate.scope != "common":
        entry[candidate.kind] = [int(site) for site in candidate.own_sites]
    sentences = [
        words.finding(entry, EFFECTS[candidate.name]),
        *identities.sentences(diagnosis.search, after, index, alternatives),
    ]
    entry["sentence"] = " ".join(sentences)
    return entry


def _is_certain(diagnosis: Diagnosis, index: int, p_value: float) -> bool:
    """Whether an effect is more than a candidate: the fit as a whole is acceptable, the effect
    stands out from what has no name, and what is left, where there probably is something, could
    not tell it from another name."""
    after, gaps, other = diagnosis.after, diagnosis.gaps[index], diagnosis.other
    effect, admits = after.effects[index], diagnosis.search.journal.admits
    accepted = admits(ACCEPTABLE, p_value, effect, after)
    stands_out = admits(STANDS_OUT, gaps[0].snr if gaps else np.inf, effect, after)
    nearest = min((g.gap for g in gaps if DISTINCT.admits(g.gap)), default=np.inf)
    distinct = NOTHING_UNNAMED.admits(other.probability) or admits(
        REMAINDER, nearest - other.snr, effect, after
    )
    return accepted and stands_out and distinct


def _share(diagnosis: Diagnosis, index: int) -> float:
    """Share of the reserve's excess chi squared that returns without an effect, of 0 to 1."""
    reserve, after = diagnosis.reserve, diagnosis.after
    chi2_before, chi2_after, chi2_without = (
        reserve.predicted(fit).chi2.sum()
        for fit in (
            diagnosis.before.fit,
            after.fit,
            reduced(diagnosis.search, after, index).fit,
        )
    )
    excess = chi2_before - reserve.predicted(diagnosis.before.fit).readings
    share = (chi2_without - chi2_after) / excess if excess > 0.0 else 0.0
    return float(np.clip(share, 0.0, 1.0))
