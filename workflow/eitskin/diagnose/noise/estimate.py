"""The noise of a recording, from the recording alone.

Two witnesses that no model of the skin enters, on combinations of channels that share no noise.
The odd half of reciprocity: a passive, linear skin gives reciprocal channels one value, so their
contrasts hold noise and what the instrument does, which is coherent over frames and is taken away.
And repeats: the rest of the channels in untouched frames. Coherent modes are singular values above
those of pure noise (Marchenko & Pastur 1967; largest: Johnstone, Ann. Statist. 29, 2001).
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.optimize import nnls
from scipy.stats import chi2, f

from eitskin.data.recording import Recording
from eitskin.physics.protocol import tied_channels

ROUNDING = 12**-0.5  # of a converter's step: the sd of an even distribution over it
DITHERED = 0.01  # of the noise: what rounding does to all frames alike is lost below it
ALIKE = 1e-9  # of the largest reading: values closer are one
OFF_STEP = 0.05  # of a step, that a gap between values may be from whole ones
LEAST_GAPS = 0.1  # the quantile of gaps between values that is a step: wider ones hold several
FLOOR = 1e-6  # of the median |v|
ASSUMED = 1e-3  # of the median |v|, where nothing shows the noise
MOST_LOST = 0.5  # of a channel's frames or a frame's channels, else it is left out
TRACY_WIDOM = 2.0234  # 99 % quantile of the largest singular value squared, standardised
ALPHA = 1e-3  # witnesses disagree, or a law is needed, below this probability
LEAST_ROWS = 4  # fewer independent rows show no modes
ROUNDS = 4
FILLS, FILLED = 5, 0.02  # rounds a mode at most; the last changes less than this share


@dataclass(frozen=True)
class Law:
    """Sd of readings by their untouched level v: its square is constant + growth v^2, and it is
    at least `least`."""

    constant: float
    growth: float
    least: float = 0.0

    def __call__(self, level: np.ndarray) -> np.ndarray:
        """(M,) sd of channels of these levels (M,)."""
        return np.maximum(np.sqrt(self.constant + self.growth * level**2), self.least)


@dataclass(frozen=True)
class Noise:
    """Standard deviation `sd` (M,) of each channel in the recording's unit; `dof`: degrees of
    freedom of its overall scale (squared); `source`: where it comes from, for a reader.

    rounding: sd of what rounding does alike in frames that are alike, the same in all channels;
    step: that of a converter that does so, else 0.
    correlation: of each channel's own noise from one frame to the next, by their numbers, of which
    `sd` is the stationary one; drift: sd at the recording's end, in units of `sd`, of a random walk
    of each channel on its own in time. lost (N, M): readings put aside as spikes, whose number is
    `spikes`, or in `loud_frames` (rows); None: none. law: by which `sd` was estimated.
    """

    sd: np.ndarray
    dof: float
    source: str
    rounding: float = 0.0
    step: float = 0.0
    correlation: float = 0.0
    drift: float = 0.0
    lost: np.ndarray | None = None
    loud_frames: tuple[int, ...] = ()
    spikes: int = 0
    law: Law | None = None

    def told_of(self, unseen: np.ndarray, level: np.ndarray) -> "Noise":
        """The same noise, of `unseen` channels (M,) by the law at what a simulation has for their
        untouched level (M,): their own readings are not to be looked at."""
        if self.law is None:
            return self
        return replace(self, sd=np.where(unseen, self.law(level), self.sd))

    def correlation_sd(self, correlation: float) -> float:
        """Of a correlation found from as many values as `dof` (Bartlett 1946)."""
        return float(np.sqrt((1.0 - correlation**2) / self.dof))


@dataclass(frozen=True)
class _Witness:
    """Variances (C,) of combinations of channels, their degrees of freedom (C,) and squared
    level (C,): the mean square of the channels' untouched values."""

    variance: np.ndarray
    dof: np.ndarray
    level: np.ndarray


@dataclass(frozen=True)
class _Seen:
    """Readings (N, M) without gaps, which frames are untouched (N,), the odd and the other
    combinations, the squared level and the filled share of each channel (M,)."""

    values: np.ndarray
    still: np.ndarray
    odd: np.ndarray
    even: np.ndarray
    squared: np.ndarray
    share: np.ndarray

    def witnesses(self, law: np.ndarray) -> tuple[dict[str, _Witness], np.ndarray]:
        """What the readings say and the law by it, from a first guess of the law."""
        for _ in range(ROUNDS):
            found = {}
            if self.odd.shape[1]:
                found["odd"] = self._witness(self.values, self.odd, law, self._touch_modes(law))
            if self.still.sum() > 1:
                found["repeats"] = self._witness(self.values[self.still], self.even, law)
            if not found:
                found["bulk"] = self._witness(self.values, self.even, law)
            law = _law(list(found.values()))
        return found, law

    def _touch_modes(self, law: np.ndarray) -> np.ndarray:
        """(N, K) orthonormal courses over the frames that the even half shows: the skin's, and so
        those of whatever an instrument makes of its readings. At most half of the frames."""
        scaled = (
            self.values @ self.even / np.sqrt(law[0] + law[1] * (self.even**2).T @ self.squared)
        )
        left, sizes, _ = np.linalg.svd(scaled - scaled.mean(axis=0), full_matrices=False)
        rank = rank_above_noise(sizes, (len(scaled) - 1, scaled.shape[1]))
        return left[:, : min(rank, (len(scaled) - 1) // 2)]

    def _witness(
        self,
        values: np.ndarray,
        combinations: np.ndarray,
        law: np.ndarray,
        modes: np.ndarray | None = None,
    ) -> _Witness:
        """What is left of `combinations` (M, C) of values (N, M) less their mean over frames, the
        courses `modes` (N, K) and coherent modes of their own."""
        weight = combinations**2
        level = weight.T @ self.squared
        scale = np.sqrt(law[0] + law[1] * level)
        known = np.ones((len(values), 1))
        if modes is not None:
            known = np.column_stack([known, modes])
        complement = np.linalg.qr(known, mode="complete")[0][:, known.shape[1] :]
        rows = complement.T @ (values @ combinations) / scale
        left, sizes, right = np.linalg.svd(rows, full_matrices=False)
        rank = rank_above_noise(sizes, rows.shape)
        left_over = (left[:, rank:] * sizes[rank:]) @ right[rank:] * scale
        dof = (len(rows) - rank) * (1.0 - rank / rows.shape[1]) * (1.0 - weight.T @ self.share)
        return _Witness(np.sum(left_over**2, axis=0) / dof, dof, level)


def estimate(recording: Recording) -> Noise:
    """The noise of a recording with readings.

    sd_k² = a² + b² v_k², v the mean untouched |value|, with b = 0 unless the readings ask for it.
    """
    absolute = recording.metadata["values"] == "absolute"
    touch = recording.frames["touch"].to_numpy(bool)
    voltage = recording.readings
    size = float(np.nanmedian(np.abs(voltage)))
    level = np.zeros(voltage.shape[1])
    if absolute:
        lost = np.isnan(voltage[~touch]).all(axis=0)
        level[~lost] = np.abs(np.nanmean(voltage[~touch][:, ~lost], axis=0))
        level[lost] = np.median(level[~lost]) if not lost.all() else 0.0
    usable, kept, filled, share = _filled(voltage)
    signs = recording.metadata["voltage"] == "signed"
    odd, even = parity(recording.channels[usable], signs)
    squared = level[usable] ** 2
    still = ~touch[kept]
    if len(filled) < 2:
        return _one_frame(filled, odd, size, len(level))
    seen = _Seen(filled, still, odd, even, squared, share)
    # Under a wrong law noisy channels look like modes: the start that leaves the most is right.
    starts = [np.array([1.0, 0.0]), np.array([np.median(squared), 1.0])]
    runs = [seen.witnesses(start) for start in (starts if squared.any() else starts[:1])]
    witnesses, likeliest = max(runs, key=lambda run: sum(w.dof.sum() for w in run[0].values()))
    told, fitted, said = _combined(witnesses, likeliest)
    words = {
        "odd": f"the odd half of {odd.shape[1]} reciprocal contrasts over {len(filled)} frames",
        "repeats": f"{still.sum()} untouched frames",
        "bulk": f"what is incoherent in {len(filled)} frames",
    }
    law = Law(*fitted.tolist())
    sd = law(level)
    source = " and ".join(words[name] for name in told) + said
    source += "; it grows with the reading" if law.growth > 0 else "; alike in all channels"
    step = converter_step(voltage)
    alike = rounding_alike(step, float(np.median(sd)))
    # Frames at rest do not show what rounding does to them all alike; touched ones have it.
    unseen = alike**2 if told == ["repeats"] else 0.0
    law = replace(law, constant=law.constant + unseen, least=ROUNDING * step)
    if (law(level) > sd).any():
        sd = law(level)
        source += f"; raised to that of rounding to steps of {step:.3g}"
    floor = FLOOR * size
    if (sd < floor).any():
        law = replace(law, least=max(law.least, floor))
        sd = law(level)
        source += f"; raised to {FLOOR:g} of the median reading, below which no noise is told"
    dof = float(sum(witnesses[name].dof.sum() for name in told))
    return Noise(sd, dof, source, alike, step if alike else 0.0, law=law)


def converter_step(voltage: np.ndarray) -> float:
    """Between neighbouring values that readings (N, M) take, where half of them or more say what
    others say too and gaps are whole steps; else 0.

    Rounded to steps much wider than the noise, untouched frames have the same error each time:
    their scatter does not show it.
    """
    readings = voltage[np.isfinite(voltage)]
    values = np.unique(readings)
    values = values[np.append(True, np.diff(values) > ALIKE * np.abs(values).max(initial=0.0))]
    if len(values) < 2 or 2 * len(values) > len(readings):
        return 0.0
    gaps = np.diff(values)
    step = float(np.quantile(gaps, LEAST_GAPS))
    off = np.abs(gaps / step - np.round(gaps / step))
    return step if np.mean(off < OFF_STEP) > 1.0 - LEAST_GAPS else 0.0


def rounding_alike(step: float, sd: float) -> float:
    """Sd of the mean of what rounding to steps does to a reading at rest, whose scatter is `sd`
    with the rounding in it; 0 where that is lost in the scatter.

    Over noise of sd s a value x has the mean error sum_k (-1)^k step / (pi k) sin(2 pi k x / step)
    exp(-2 pi^2 k^2 s^2 / step^2); x is even over a step (Widrow, Kollar, Quantization Noise, 2008).
    """
    if step == 0.0:
        return 0.0
    noise = max((sd / step) ** 2 - ROUNDING**2, 0.0)
    k2 = np.arange(1, 200) ** 2
    power = np.sum(np.exp(-4.0 * np.pi**2 * k2 * noise) / k2)
    alike = step * float(np.sqrt(power / 2.0) / np.pi)
    return alike if alike > DITHERED * sd else 0.0


def parity(channels: np.ndarray, signed: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal combinations of channels (M, 4): odd (M, P), which a passive, linear skin leaves
    at 0 whatever its state, and the rest (M, M - P).

    Channels that reciprocity ties to one value (up to sign; all alike where not `signed`) give
    their mean to the rest and their contrasts (Helmert) to the odd half.
    """
    count = len(channels)
    group, sign = tied_channels(channels)
    if not signed:
        sign[:] = 1.0
    odd, even = [], []
    for label in np.unique(group):
        members = np.flatnonzero(group == label)
        mean = np.zeros(count)
        mean[members] = sign[members] / np.sqrt(len(members))
        even.append(mean)
        for k in range(1, len(members)):
            contrast = np.zeros(count)
            contrast[members[:k]] = sign[members[:k]]
            contrast[members[k]] = -k * sign[members[k]]
            odd.append(contrast / np.sqrt(k * (k + 1)))
    return np.array(odd).reshape(-1, count).T, np.array(even).reshape(-1, count).T


def _filled(voltage: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Channels and frames that are not mostly lost, their readings with the lost ones filled from
    the coherent modes, and the share (M',) of each channel that was filled."""
    lost = np.isnan(voltage)
    usable = np.flatnonzero(lost.mean(axis=0) <= MOST_LOST)
    if len(usable) == 0:
        usable = np.flatnonzero(~lost.all(axis=0))
    kept = np.flatnonzero(lost[:, usable].mean(axis=1) <= MOST_LOST)
    values, gaps = voltage[np.ix_(kept, usable)], lost[np.ix_(kept, usable)]
    empty = gaps.all(axis=0)
    usable, values, gaps = usable[~empty], values[:, ~empty], gaps[:, ~empty]
    if gaps.any():
        mean = np.nanmean(values, axis=0)
        values = np.where(gaps, mean, values)
        # One mode more at a time: modes that the gaps themselves make are never fitted.
        for rank in range(min(values.shape) - 1):
            for _ in range(FILLS):
                mean = values.mean(axis=0)
                left, sizes, right = np.linalg.svd(values - mean, full_matrices=False)
                fit = mean + (left[:, :rank] * sizes[:rank]) @ right[:rank]
                change = np.sqrt(np.mean((fit - values)[gaps] ** 2))
                values = np.where(gaps, fit, values)
                if change <= FILLED * np.sqrt(np.mean((fit - values) ** 2)):
                    break
            if rank_above_noise(sizes, (len(values) - 1, values.shape[1])) <= rank:
                break
    return usable, kept, values, gaps.mean(axis=0)


def rank_above_noise(sizes: np.ndarray, shape: tuple[int, int]) -> int:
    """How many singular values, largest first, stand above those of white noise (rows, columns)
    whose sd is that at which the median of the others is the Marchenko-Pastur median."""
    rows, columns = shape
    sizes = sizes[: min(shape)]
    rank = 0
    while len(sizes) - rank >= LEAST_ROWS and rank < len(sizes) // 2 + 1:
        low, high = sorted((rows - rank, columns - rank))
        variance = np.median(sizes[rank:]) ** 2 / (high * _marchenko_pastur_median(low / high))
        root = np.sqrt(low - 0.5) + np.sqrt(high - 0.5)
        spread = root * (1.0 / np.sqrt(low - 0.5) + 1.0 / np.sqrt(high - 0.5)) ** (1.0 / 3.0)
        if sizes[rank] ** 2 <= variance * (root**2 + TRACY_WIDOM * spread):
            break
        rank += 1
    return rank


@lru_cache(maxsize=4096)
def _marchenko_pastur_median(ratio: float) -> float:
    """Median eigenvalue of X Xᵀ / n, X (p, n) of unit variance, ratio = p / n in (0, 1]."""
    angle = np.linspace(0.0, np.pi, 4001)
    value = 1.0 + ratio + 2.0 * np.sqrt(ratio) * np.cos(angle[::-1])
    density = np.sin(angle) ** 2 / np.maximum(value, 1e-12)
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return float(np.interp(0.5 * mass[-1], mass, value))


def _law(witnesses: list[_Witness]) -> np.ndarray:
    """(a², b²) of sd² = a² + b² v² by maximum likelihood (Fisher scoring, not negative); b = 0
    unless the likelihood ratio refuses it."""
    variance, dof, level = (
        np.concatenate([getattr(witness, key) for witness in witnesses])
        for key in ("variance", "dof", "level")
    )
    constant = np.sum(dof * variance) / np.sum(dof)
    if constant == 0.0 or level.max() == 0.0:
        return np.array([constant or 1e-300, 0.0])
    unit = np.mean(level)
    terms = np.column_stack([np.ones(len(level)), level / unit])
    found = np.array([constant, 0.0])
    for _ in range(50):
        predicted = terms @ found
        weight = np.sqrt(dof) / predicted
        found = nnls(terms * weight[:, None], variance * weight)[0]
        found = np.maximum(found, 1e-9 * constant)
    free = _deviance(terms @ found, variance, dof)
    same = _deviance(np.full(len(level), constant), variance, dof)
    if chi2.sf(same - free, 1) > ALPHA:
        return np.array([constant, 0.0])
    return found / np.array([1.0, unit])


def _deviance(predicted: np.ndarray, variance: np.ndarray, dof: np.ndarray) -> float:
    return float(np.sum(dof * (np.log(predicted) + variance / predicted)))


def _combined(witnesses: dict[str, _Witness], law: np.ndarray) -> tuple[list[str], np.ndarray, str]:
    """The witnesses that are believed, the law by them, and what to say of it."""
    names = list(witnesses)
    if len(names) == 1:
        return names, law, ""
    scale, dof = {}, {}
    for name, witness in witnesses.items():
        predicted = law[0] + law[1] * witness.level
        dof[name] = witness.dof.sum()
        scale[name] = np.sum(witness.dof * witness.variance / predicted) / dof[name]
    larger, smaller = sorted(names, key=lambda name: -scale[name])
    if scale[smaller] == 0.0:
        return names, law, ""
    ratio = scale[larger] / scale[smaller]
    p_value = 2.0 * min(0.5, f.sf(ratio, dof[larger], dof[smaller]))
    if p_value > ALPHA:
        return names, law, f" agree (p = {p_value:.2g})"
    other = {"odd": "the odd half of reciprocity", "repeats": "the untouched frames"}[larger]
    said = f"; {other} would say {np.sqrt(ratio):.3g} times as much, so it holds more than noise"
    return [smaller], _law([witnesses[smaller]]), said


def _one_frame(filled: np.ndarray, odd: np.ndarray, size: float, count: int) -> Noise:
    """Of one frame: the odd half by its median, which bounds the noise from above; else assumed."""
    if odd.shape[1]:
        spread = np.median(np.abs(filled[0] @ odd)) / 0.6745
        source = (
            f"the odd half of {odd.shape[1]} reciprocal contrasts in the only frame, an upper "
            "bound: one frame cannot tell noise from what drive and measurement do differently"
        )
        # The median absolute deviation has 0.37 of the variance's efficiency.
        sd, dof = max(spread, FLOOR * size), 0.37 * odd.shape[1]
    else:
        source = (
            f"assumed, {ASSUMED:g} of the median reading: one frame without reciprocal pairs "
            "shows no noise"
        )
        sd, dof = ASSUMED * size, 1.0
    return Noise(np.full(count, sd), dof, source)
