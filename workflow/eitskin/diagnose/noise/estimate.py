"""The noise of a recording, from the recording alone.

Two witnesses that no model of the skin enters, on combinations of channels that share no noise.
The odd half of reciprocity: a passive, linear skin gives reciprocal channels one value, so their
contrasts hold noise and what the instrument does, which is coherent over frames and is taken away.
And repeats: the rest of the channels in untouched frames. Coherent modes are those that
`rank_above_noise` counts.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls
from scipy.stats import chi2, f

from eitskin.data.recording import Recording
from eitskin.diagnose.noise.coherent_rank import rank_above_noise
from eitskin.diagnose.noise.converter import ROUNDING, converter_step, lasting_rounding_sd
from eitskin.diagnose.noise.noise_model import NoiseModel, VarianceLaw
from eitskin.diagnose.noise.reciprocity import parity
from eitskin.diagnose.noise.single_frame import beside_gains, single_frame_law

FLOOR = 1e-6  # of the median |v|: no board resolves less
ASSUMED = 1e-3  # of the median |v|, where nothing shows the noise: of an ordinary board
MOST_LOST = 0.5  # of a channel's frames or a frame's channels, else it is left out
ALPHA = 1e-3  # witnesses disagree, or a law is needed, below this probability
ROUNDS = 4  # in which the law and the number of modes follow each other
FILL_ROUNDS, FILL_CHANGE = 5, 0.02  # for every mode, at most; the last one changes less, relatively
SCORING_ROUNDS = 50  # of the law's likelihood, which converges in some ten
LEAST_SHARE = 1e-9  # of the mean variance, that each term of the law has at least while it is found


@dataclass(frozen=True)
class _Witness:
    """Variances (C,) of combinations of channels, their degrees of freedom (C,) and squared
    level (C,): the mean square of the channels' untouched values."""

    variance: np.ndarray
    dof: np.ndarray
    level: np.ndarray

    def predicted(self, law: np.ndarray) -> np.ndarray:
        """(C,): the variances by a law (constant, growth)."""
        return law[0] + law[1] * self.level


@dataclass(frozen=True)
class _CompleteReadings:
    """Readings (N, M) with gaps filled, which frames are untouched (N,), the odd and the even
    combinations of channels, the squared level (M,), the share of filled frames (M,) and the
    channels (M, 4)."""

    values: np.ndarray
    untouched: np.ndarray
    odd: np.ndarray
    even: np.ndarray
    squared_level: np.ndarray
    filled_share: np.ndarray
    channels: np.ndarray

    def witnesses(self, law: np.ndarray) -> tuple[dict[str, _Witness], np.ndarray]:
        """The witnesses by name and the law by them, from a first guess of the law."""
        for _ in range(ROUNDS):
            witnesses = {}
            if self.odd.shape[1]:
                touch_modes = self._touch_modes(law)
                witnesses["odd"] = self._witness(self.values, self.odd, law, touch_modes)
            if self.untouched.sum() > 1:
                repeats = self.values[self.untouched]
                witnesses["repeats"] = self._witness(repeats, self.even, law)
            if not witnesses:
                witnesses["bulk"] = self._witness(self.values, self.even, law)
            law = _law(list(witnesses.values()))
        return witnesses, law

    def _touch_modes(self, law: np.ndarray) -> np.ndarray:
        """(N, K) orthonormal time series that the even half shows: those of the skin, and so of
        whatever an instrument makes of its readings. At most half as many as frames."""
        scaled = (
            self.values
            @ self.even
            / np.sqrt(law[0] + law[1] * (self.even**2).T @ self.squared_level)
        )
        left_vectors, singular_values, _ = np.linalg.svd(
            scaled - scaled.mean(axis=0), full_matrices=False
        )
        rank = rank_above_noise(singular_values, (len(scaled) - 1, scaled.shape[1]))
        return left_vectors[:, : min(rank, (len(scaled) - 1) // 2)]

    def _witness(
        self,
        values: np.ndarray,
        combinations: np.ndarray,
        law: np.ndarray,
        modes: np.ndarray | None = None,
    ) -> _Witness:
        """The variance of `combinations` (M, C) of values (N, M) beside their mean over frames, the
        time series `modes` (N, K) and their coherent modes."""
        weight = combinations**2
        level = weight.T @ self.squared_level
        scale = np.sqrt(law[0] + law[1] * level)
        explained = np.ones((len(values), 1))
        if modes is not None:
            explained = np.column_stack([explained, modes])
        complement = np.linalg.qr(explained, mode="complete")[0][:, explained.shape[1] :]
        rows = complement.T @ (values @ combinations) / scale
        left_vectors, singular_values, right_vectors = np.linalg.svd(rows, full_matrices=False)
        rank = rank_above_noise(singular_values, rows.shape)
        incoherent = (
            (left_vectors[:, rank:] * singular_values[rank:]) @ right_vectors[rank:] * scale
        )
        filled = weight.T @ self.filled_share
        dof = (len(rows) - rank) * (1.0 - rank / rows.shape[1]) * (1.0 - filled)
        return _Witness(np.sum(incoherent**2, axis=0) / dof, dof, level)


def estimate_noise(recording: Recording) -> NoiseModel:
    """The noise of a recording with readings.

    sd_k^2 = a^2 + b^2 v_k^2, v_k the mean untouched |value| of channel k, with b = 0 unless the
    readings ask for it.
    """
    voltage = recording.readings
    typical = float(np.nanmedian(np.abs(voltage)))
    level = _untouched_level(recording)
    readings, row_count = _complete_readings(recording, level)
    if row_count < 2:
        return _single_frame_noise(readings, typical, level)
    # Under a wrong law noisy channels look like modes: the start that leaves the most is right.
    squared = readings.squared_level
    starts = [np.array([1.0, 0.0]), np.array([np.median(squared), 1.0])]
    runs = [readings.witnesses(start) for start in (starts if squared.any() else starts[:1])]
    witnesses, likeliest = max(runs, key=lambda run: sum(w.dof.sum() for w in run[0].values()))
    believed, terms, comparison = _combined(witnesses, likeliest)
    words = {
        "odd": f"the odd half of {readings.odd.shape[1]} reciprocal contrasts over {row_count}"
        " frames",
        "repeats": f"{readings.untouched.sum()} untouched frames",
        "bulk": f"what is incoherent in {row_count} frames",
    }
    law = VarianceLaw(*terms.tolist())
    sd = law(level)
    source = " and ".join(words[name] for name in believed) + comparison
    source += "; it grows with the reading" if law.growth > 0 else "; alike in all channels"
    step = converter_step(voltage)
    rounding_sd = lasting_rounding_sd(step, float(np.median(sd)))
    # Frames at rest do not show what rounding does to them all alike; touched ones have it.
    hidden = rounding_sd**2 if believed == ["repeats"] else 0.0
    law = replace(law, constant=law.constant + hidden, floor=ROUNDING * step)
    if (law(level) > sd).any():
        sd = law(level)
        source += f"; raised to that of rounding to steps of {step:.3g}"
    floor = FLOOR * typical
    if (sd < floor).any():
        law = replace(law, floor=max(law.floor, floor))
        sd = law(level)
        source += f"; raised to {FLOOR:g} of the median reading, below which no noise is told"
    dof = float(sum(witnesses[name].dof.sum() for name in believed))
    return NoiseModel(sd, dof, source, rounding_sd, step if rounding_sd else 0.0, law=law)


def _untouched_level(recording: Recording) -> np.ndarray:
    """(M,): mean untouched |value| of each channel, the median of the others where a channel has
    none; 0 for differences."""
    level = np.zeros(recording.readings.shape[1])
    if recording.metadata["values"] == "absolute":
        untouched = recording.readings[~recording.frames["touch"].to_numpy(bool)]
        lost = np.isnan(untouched).all(axis=0)
        level[~lost] = np.abs(np.nanmean(untouched[:, ~lost], axis=0))
        level[lost] = np.median(level[~lost]) if not lost.all() else 0.0
    return level


def _complete_readings(recording: Recording, level: np.ndarray) -> tuple[_CompleteReadings, int]:
    """The readings of frames and channels that are not mostly lost, and the number of these
    frames; level (M,): untouched, of all channels."""
    usable, rows, values, filled_share = _filled(recording.readings)
    signed = recording.metadata["voltage"] == "signed"
    odd, even = parity(recording.channels[usable], signed)
    untouched = ~recording.frames["touch"].to_numpy(bool)[rows]
    squared = level[usable] ** 2
    complete = _CompleteReadings(
        values, untouched, odd, even, squared, filled_share, recording.channels[usable]
    )
    return complete, len(values)


def _filled(voltage: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Channels and frames that are not mostly lost, their readings with the lost ones filled from
    the coherent modes, and the share (M',) of each channel that was filled."""
    lost = np.isnan(voltage)
    usable = np.flatnonzero(lost.mean(axis=0) <= MOST_LOST)
    if len(usable) == 0:
        usable = np.flatnonzero(~lost.all(axis=0))
    rows = np.flatnonzero(lost[:, usable].mean(axis=1) <= MOST_LOST)
    values, gaps = voltage[np.ix_(rows, usable)], lost[np.ix_(rows, usable)]
    empty = gaps.all(axis=0)
    usable, values, gaps = usable[~empty], values[:, ~empty], gaps[:, ~empty]
    if gaps.any():
        mean = np.nanmean(values, axis=0)
        values = np.where(gaps, mean, values)
        # One mode more at a time: modes that the gaps themselves make are never fitted.
        for rank in range(min(values.shape) - 1):
            for _ in range(FILL_ROUNDS):
                mean = values.mean(axis=0)
                left_vectors, singular_values, right_vectors = np.linalg.svd(
                    values - mean, full_matrices=False
                )
                fit = (
                    mean + (left_vectors[:, :rank] * singular_values[:rank]) @ right_vectors[:rank]
                )
                change = np.sqrt(np.mean((fit - values)[gaps] ** 2))
                values = np.where(gaps, fit, values)
                if change <= FILL_CHANGE * np.sqrt(np.mean((fit - values) ** 2)):
                    break
            if rank_above_noise(singular_values, (len(values) - 1, values.shape[1])) <= rank:
                break
    return usable, rows, values, gaps.mean(axis=0)


def _law(witnesses: list[_Witness]) -> np.ndarray:
    """(a^2, b^2) of sd^2 = a^2 + b^2 v^2 by maximum likelihood (Fisher scoring, not negative);
    b = 0 unless the likelihood ratio refuses it."""
    variance, dof, level = (
        np.concatenate([getattr(witness, key) for witness in witnesses])
        for key in ("variance", "dof", "level")
    )
    constant = np.sum(dof * variance) / np.sum(dof)
    if constant == 0.0 or level.max() == 0.0:
        return np.array([constant or 1e-300, 0.0])
    unit = np.mean(level)
    basis = np.column_stack([np.ones(len(level)), level / unit])
    terms = np.array([constant, 0.0])
    for _ in range(SCORING_ROUNDS):
        predicted = basis @ terms
        weight = np.sqrt(dof) / predicted
        terms = nnls(basis * weight[:, None], variance * weight)[0]
        terms = np.maximum(terms, LEAST_SHARE * constant)
    growing = _deviance(basis @ terms, variance, dof)
    even = _deviance(np.full(len(level), constant), variance, dof)
    if chi2.sf(even - growing, 1) > ALPHA:
        return np.array([constant, 0.0])
    return terms / np.array([1.0, unit])


def _deviance(predicted: np.ndarray, variance: np.ndarray, dof: np.ndarray) -> float:
    """-2 log likelihood of variances (C,), up to a constant."""
    return float(np.sum(dof * (np.log(predicted) + variance / predicted)))


def _combined(witnesses: dict[str, _Witness], law: np.ndarray) -> tuple[list[str], np.ndarray, str]:
    """The names of the witnesses that are believed, the law by them, and how they compare, in
    words."""
    names = list(witnesses)
    if len(names) == 1:
        return names, law, ""
    scale, dof = {}, {}
    for name, witness in witnesses.items():
        dof[name] = witness.dof.sum()
        scale[name] = np.sum(witness.dof * witness.variance / witness.predicted(law)) / dof[name]
    larger, smaller = sorted(names, key=lambda name: -scale[name])
    if scale[smaller] == 0.0:
        return names, law, ""
    ratio = scale[larger] / scale[smaller]
    p_value = 2.0 * min(0.5, f.sf(ratio, dof[larger], dof[smaller]))
    if p_value > ALPHA:
        return names, law, f" agree (p = {p_value:.2g})"
    words = {"odd": "the odd half of reciprocity", "repeats": "the untouched frames"}[larger]
    comparison = (
        f"; {words} would say {np.sqrt(ratio):.3g} times as much, so it holds more than noise"
    )
    return [smaller], _law([witnesses[smaller]]), comparison


def _single_frame_noise(
    readings: _CompleteReadings, typical: float, level: np.ndarray
) -> NoiseModel:
    """Of one frame: the odd half, which bounds the noise from above; else assumed. typical: median
    |v|; level (M,): untouched, of all channels."""
    odd = readings.odd
    floor = FLOOR * typical
    if odd.shape[1]:
        contrasts, squared_level = readings.values[0] @ odd, (odd**2).T @ readings.squared_level
        note, free_of_gains = "", beside_gains(readings.values[0], readings.channels)
        if free_of_gains is not None:
            contrasts, squared_level = free_of_gains
            note = f", {len(contrasts)} beside the gains of drives and measuring pairs"
        law, dof = single_frame_law(contrasts, squared_level)
        source = (
            f"the odd half of {odd.shape[1]} reciprocal contrasts in the only frame{note}, an "
            "upper bound: one frame cannot tell noise from what drive and measurement do "
            "differently"
        )
        law = replace(law, floor=floor)
    else:
        source = (
            f"assumed, {ASSUMED:g} of the median reading: one frame without reciprocal pairs "
            "shows no noise"
        )
        law, dof = VarianceLaw((ASSUMED * typical) ** 2, 0.0, floor), 1.0
    return NoiseModel(law(level), dof, source, law=law)
