"""A skin whose current comes back through ground: a law for misfits that are one-sided.

Exchanging source and sink turns the sign of every reading of a passive skin between a floating
source's ends, and no more. Where magnitudes change with it, and fall steadily once round from the
source, something tells source from sink. The law tried here: the source drives against ground, each
electrode leaks to ground (`leak`, of the skin's own conductance), the sink more than the others
(`sink`), the two inputs of the amplifier weigh unequally (`common_mode`), and a constant is added
(`offset`): (G + Y) u = e_source, v = |u+ - u- + common_mode (u+ + u-) / 2 + offset|.

It is judged against the owner's simulation and against free means over rotations, all fitted to
half of the drives in the first half of the untouched frames: on the other drives in the later
frames; on what reversing the drive changes; on drift, each law's common numbers fitted anew to the
first and the last tenth; on what touches change, which none of them was fitted to.

The law was found on the hydrogel skin itself: its form on all untouched frames, its gains by drives
left out, the best of some ten extensions. So its score there flatters; other skins would judge it.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.quantities import percent

SPLITS = 20
WIDTH = 0.25  # of the pitch, where nobody gives one
TOUCH = 0.1  # radius of a touch of unknown size, over the skin's
DENT = -0.5  # contrast of the deepest touch: a dent thins the gel; correlations do not see its size
STARTS = [(y, a, r, 0.0) for y in (-3.0, 0.0) for a in (-3.0, 0.0, 3.0) for r in (-0.5, 0.5)]
LOW, HIGH = np.array([-7.0, -7.0, -2.0, -50.0]), np.array([7.0, 7.0, 2.0, 50.0])
GAIN_SD = 0.1  # prior of a measuring pair's gain
ROUNDS = 40
ALTERNATIONS = 20
PREDICTED = 0.5  # share of the sum of squares that a law must have
WITH_GAINS = " and a gain a measuring pair"


@dataclass(frozen=True)
class Drives:
    """|v| of a recording's untouched frames and what touches change, and the skin's impedance.

    channels (M, 4); untouched (F, M), in order; changes (T, M) pressed minus the untouched frame
    before it; places (T, 3) mm: x, y and depth; n electrodes at angles (n,) in degrees.
    """

    channels: np.ndarray
    untouched: np.ndarray
    changes: np.ndarray
    places: np.ndarray
    angles: np.ndarray
    radius_mm: float

    @classmethod
    def of(cls, recording: Recording) -> "Drives":
        """InputError without reversed drives, untouched frames before touches, or a known disc."""
        skin, frames = recording.skin, recording.frames
        touch = frames["touch"].to_numpy(bool)
        if skin.electrode_deg is None or skin.radius_mm is None:
            raise InputError("recording", "skin", "no radius or no angles", "a disc that is known")
        pressed = np.flatnonzero(touch[1:] & ~touch[:-1]) + 1
        if recording.metadata["values"] == "difference" or len(pressed) < 20:
            found = f"{len(pressed)} touches with an untouched frame before"
            raise InputError("recording", "frames", found, "20 or more, absolute")
        size = np.abs(recording.readings)
        depth = frames["depth_mm"].fillna(1.0).to_numpy(float)
        made = cls(
            recording.channels,
            size[~touch],
            size[pressed] - size[pressed - 1],
            np.column_stack([frames["x_mm"], frames["y_mm"], depth])[pressed].astype(float),
            np.array(skin.electrode_deg),
            skin.radius_mm,
        )
        if not np.isfinite(size).all() or (made.reversed < 0).any():
            found = "lost readings or drives without their reverse"
            raise InputError("recording", "channels", found, "every drive both ways, complete")
        return made

    @cached_property
    def reversed(self) -> np.ndarray:
        """(M,): the channel with source and sink exchanged, -1 where there is none."""
        pairs = [(s, t, *sorted((p, m))) for s, t, p, m in self.channels.tolist()]
        at = {pair: k for k, pair in enumerate(pairs)}
        return np.array([at.get((t, s, p, m), -1) for s, t, p, m in pairs])

    @cached_property
    def separation(self) -> np.ndarray:
        """(M,): which channels a turn by one electrode makes equal."""
        n = len(self.angles)
        turned = (self.channels - self.channels[:, :1]) % n
        return np.unique(turned, axis=0, return_inverse=True)[1].ravel()

    @cached_property
    def forward(self) -> Forward:
        """The skin as a sheet of unit conductivity."""
        pitch = 2.0 * np.pi * self.radius_mm / len(self.angles)
        width = np.array(WIDTH * pitch)
        geometry = Geometry(self.radius_mm, 1.0, 1.0, self.angles, width, np.array(1e-5))
        return Forward(geometry, "train")

    @cached_property
    def unit(self) -> float:
        """Ohm: the largest transfer impedance, by which all are divided."""
        return float(np.abs(self.forward.transfer_impedance()).max())

    @cached_property
    def transfer_impedance(self) -> np.ndarray:
        """(1, n, n): untouched."""
        return self.forward.transfer_impedance()[None] / self.unit

    @cached_property
    def pressed(self) -> np.ndarray:
        """(T, n, n): at each touch."""
        deepest = self.places[:, 2].max()
        found = np.repeat(self.transfer_impedance, len(self.places), axis=0)
        radius = TOUCH * self.radius_mm
        for row, (x, y, depth) in zip(found, self.places, strict=True):
            place = (x, y, min(radius, 0.95 * (self.radius_mm - np.hypot(x, y))))
            change = self.forward.place(*place).impedance_change(np.array([DENT * depth / deepest]))
            row += change[0] / self.unit
        return found


class OwnersLaw:
    """The simulation as its owner has it: current from source to sink, a difference read."""

    numbers, size, start = 1, 0, ((),)

    def __init__(self, drives: Drives, name: str = "the owner's simulation"):
        self.drives, self.name = drives, name

    def readings(self, values: np.ndarray, impedance: np.ndarray) -> np.ndarray:
        """(N, M) |v| up to a factor, of impedance (N, n, n)."""
        source, sink, plus, minus = self.drives.channels.T
        voltage = impedance[:, plus, source] - impedance[:, minus, source]
        return np.abs(voltage - impedance[:, plus, sink] + impedance[:, minus, sink])


class GroundReturn(OwnersLaw):
    """The law of this file: logarithms of leak and sink, common_mode, offset over mean |u+ - u-|;
    with `gains`, the logarithm of a gain of each measuring pair too."""

    def __init__(self, drives: Drives, gains: bool = False):
        super().__init__(drives)
        self.pairs, self.pair = np.unique(
            np.sort(drives.channels[:, 2:], axis=1), axis=0, return_inverse=True
        )
        self.pair = self.pair.ravel()
        self.size = 4 + (len(self.pairs) if gains else 0)
        self.numbers = 1 + self.size
        self.name = "return through ground" + (WITH_GAINS if gains else "")
        self.start = tuple(np.r_[start, np.zeros(self.size - 4)] for start in STARTS)

    def potentials(self, values: np.ndarray, impedance: np.ndarray) -> np.ndarray:
        """(N, D, n) of unit currents into each drive's source, above ground."""
        n = impedance.shape[-1]
        centre = np.eye(n) - 1.0 / n
        skin = np.linalg.pinv(centre @ impedance @ centre, hermitian=True)
        drives = self.pairs_driven
        system = np.repeat(skin[:, None], len(drives), axis=1)
        at = np.arange(n)
        system[..., at, at] += np.exp(values[0])
        system[:, np.arange(len(drives)), drives[:, 1], drives[:, 1]] += np.exp(values[1])
        current = np.eye(n)[drives[:, 0]]
        current = np.broadcast_to(current, system.shape[:-1])
        return np.linalg.solve(system, current[..., None])[..., 0]

    @cached_property
    def pairs_driven(self) -> np.ndarray:
        """(D, 2): source and sink."""
        return np.unique(self.drives.channels[:, :2], axis=0)

    def readings(self, values: np.ndarray, impedance: np.ndarray) -> np.ndarray:
        """(N, M) |v| up to a factor, of impedance (N, n, n)."""
        difference, total = self._pairs(values, impedance)
        own = difference if impedance is self.drives.transfer_impedance else None
        if own is None:
            own = self._pairs(values, self.drives.transfer_impedance)[0]
        voltage = difference + 0.5 * values[2] * total + values[3] * np.abs(own).mean()
        if len(values) > 4:
            voltage = voltage * np.exp(values[4:])[self.pair]
        return np.abs(voltage)

    def _pairs(self, values: np.ndarray, impedance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, M) u+ - u- and u+ + u-."""
        potential, channels = self.potentials(values, impedance), self.drives.channels
        drive = np.unique(channels[:, :2], axis=0, return_inverse=True)[1].ravel()
        plus, minus = potential[:, drive, channels[:, 2]], potential[:, drive, channels[:, 3]]
        return plus - minus, plus + minus

    def through_sink(self, values: np.ndarray) -> float:
        """The share of the current that leaves by the sink, mean over drives."""
        potential = self.potentials(values, self.drives.transfer_impedance)[0]
        sink = self.pairs_driven[:, 1]
        at_sink = potential[np.arange(len(sink)), sink]
        return float((at_sink * (np.exp(values[0]) + np.exp(values[1]))).mean())


@dataclass(frozen=True)
class Fitted:
    """A law's values (P,) and factor, fitted to some channels of |v| (M,)."""

    law: OwnersLaw
    values: np.ndarray
    factor: float

    @classmethod
    def to(
        cls,
        law: OwnersLaw,
        recorded: np.ndarray,
        kept: np.ndarray,
        starts: tuple,
        held: np.ndarray | None = None,
    ) -> "Fitted":
        """Least squares on channels `kept` from each of `starts`, the best; values after the
        fourth stay at `held` where that is given."""
        free = law.size if held is None else min(4, law.size)
        norm = np.linalg.norm(recorded[kept])

        def all_of(values: np.ndarray) -> np.ndarray:
            return values if held is None else np.r_[values, held[free:]]

        def modelled(values: np.ndarray) -> np.ndarray:
            model = law.readings(all_of(values), law.drives.transfer_impedance)[0]
            return model * (model[kept] @ recorded[kept] / (model[kept] @ model[kept]))

        def residual(values: np.ndarray) -> np.ndarray:
            misfit = (recorded - modelled(values))[kept] / norm
            noise = np.sqrt(kept.sum())
            return np.r_[misfit, 0.3 * values[4:] / GAIN_SD / noise, 1e-4 * values[:4]]

        best = np.zeros(0)
        if free:
            room = law.size - 4
            low, high = np.r_[LOW, np.full(room, -3.0)][:free], np.r_[HIGH, np.full(room, 3.0)]
            found = [
                least_squares(residual, s[:free], bounds=(low, high[:free]), max_nfev=ROUNDS)
                for s in starts
            ]
            best = min(found, key=lambda f: f.cost).x
        values = all_of(best)
        model = law.readings(values, law.drives.transfer_impedance)[0]
        return cls(law, values, float(modelled(best) @ model / (model @ model)))

    def readings(self, impedance: np.ndarray) -> np.ndarray:
        """(N, M) |v| of impedance (N, n, n)."""
        return self.factor * self.law.readings(self.values, impedance)


def _correlation(recorded: np.ndarray, predicted: np.ndarray) -> float:
    """0 where one of them does not vary."""
    if np.ptp(predicted) < 1e-12 * np.abs(recorded).max() or np.ptp(recorded) == 0.0:
        return 0.0
    return float(np.corrcoef(recorded, predicted)[0, 1])


def _explained(recorded: np.ndarray, predicted: np.ndarray) -> float:
    """1 - |recorded - predicted|² / |recorded|²."""
    return float(1.0 - ((recorded - predicted) ** 2).sum() / (recorded**2).sum())


def _split(law: OwnersLaw, held_out: np.ndarray) -> dict[str, float]:
    drives = law.drives
    kept, untouched = ~held_out, drives.untouched
    half, tenth = len(untouched) // 2, max(1, len(untouched) // 10)
    early, late = untouched[:half].mean(axis=0), untouched[half:].mean(axis=0)
    plain = Fitted.to(law, early, kept, law.start, np.zeros(law.size))
    fit = Fitted.to(law, early, kept, (plain.values,))
    model = fit.readings(drives.transfer_impedance)[0]
    ends = []
    for frames in (untouched[:tenth], untouched[-tenth:]):
        again = Fitted.to(law, frames.mean(axis=0), kept, (fit.values,), fit.values)
        ends.append(again.readings(drives.transfer_impedance)[0])
    drift = untouched[-tenth:].mean(axis=0) - untouched[:tenth].mean(axis=0)
    touched = (fit.readings(drives.pressed) - model)[:, held_out]
    changes = drives.changes[:, held_out]
    alike = [_correlation(r, p) for r, p in zip(changes.T, touched.T, strict=True)]
    found = _predicted(drives, held_out, model, late)
    found["drift_explained"] = _explained(drift[held_out], (ends[1] - ends[0])[held_out])
    found["touch_correlation"] = float(np.median(alike))
    if isinstance(law, GroundReturn):
        found["common_mode"] = float(fit.values[2])
        found["through_sink"] = law.through_sink(fit.values)
    return found


def _means(drives: Drives, held_out: np.ndarray, gains: bool) -> dict[str, float]:
    """As `_split`, of free means over rotations; with `gains`, times one of each measuring pair."""
    label, kept, untouched = drives.separation, ~held_out, drives.untouched
    half, tenth = len(untouched) // 2, max(1, len(untouched) // 10)
    pair = GroundReturn(drives).pair

    def best(by: np.ndarray, readings: np.ndarray, factor: np.ndarray) -> np.ndarray:
        power = np.bincount(by, factor**2 * kept)
        return np.bincount(by, readings * factor * kept) / np.where(power > 0, power, 1.0)

    def modelled(readings: np.ndarray) -> np.ndarray:
        gain = np.ones(len(label))
        for _ in range(ALTERNATIONS if gains else 0):
            mean = best(label, readings, gain)[label]
            gain = best(pair, readings, mean)[pair]
        return best(label, readings, gain)[label] * gain

    early, late = untouched[:half].mean(axis=0), untouched[half:].mean(axis=0)
    first, last = untouched[:tenth].mean(axis=0), untouched[-tenth:].mean(axis=0)
    model = modelled(early)
    return _predicted(drives, held_out, model, late) | {
        "drift_explained": _explained(
            (last - first)[held_out], (modelled(last) - modelled(first))[held_out]
        )
    }


def _predicted(
    drives: Drives, held_out: np.ndarray, model: np.ndarray, late: np.ndarray
) -> dict[str, float]:
    """Relative residual of `model` (M,) on drives left out, and what of reversal it has."""
    error = np.linalg.norm((late - model)[held_out]) / np.linalg.norm(late[held_out])
    found = {"held_out": float(error)}
    turned = held_out & held_out[drives.reversed]
    if turned.any():
        reverse = (late - late[drives.reversed])[turned]
        predicted = (model - model[drives.reversed])[turned]
        found["reversal_explained"] = _explained(reverse, predicted)
    return found


def judge(recording: Recording, seed: int = 1, count: int = SPLITS) -> pd.DataFrame:
    """Every law on `count` splits of the drives: one row a law, medians over splits.

    law; numbers: how many are fitted, the factor among them; held_out: relative residual on the
    drives left out, later frames, with low and high its 5 % and 95 % quantiles; reversal_explained,
    drift_explained: share of the sum of squares of what reversal and drift change there;
    touch_correlation: between predicted and recorded change, median channel; common_mode,
    through_sink: the law's own. InputError as `Drives.of`.
    """
    drives = Drives.of(recording)
    sources = np.unique(drives.channels[:, 0])
    rng = np.random.default_rng(seed)
    left_out = [
        np.isin(drives.channels[:, 0], rng.permutation(sources)[: len(sources) // 2])
        for _ in range(count)
    ]
    pitch = 360.0 / len(drives.angles)
    turned = replace(drives, angles=drives.angles + 0.5 * pitch)
    laws = [
        OwnersLaw(drives),
        OwnersLaw(turned, "the owner's simulation, electrodes half a pitch on"),
        GroundReturn(drives),
        GroundReturn(drives, gains=True),
    ]
    rows = []
    for law in laws:
        found = [_split(law, out) for out in left_out]
        rows.append({"law": law.name, "numbers": law.numbers, **_medians(found)})
    free, pairs = int(drives.separation.max()) + 1, laws[-1].size - 4
    for gains in (False, True):
        name = "free means over rotations" + (WITH_GAINS if gains else "")
        found = [_means(drives, out, gains) for out in left_out]
        numbers = free + gains * (pairs - 1)
        rows.insert(2 + gains, {"law": name, "numbers": numbers, **_medians(found)})
    return pd.DataFrame(rows)


def _medians(found: list[dict[str, float]]) -> dict[str, float]:
    table = pd.DataFrame(found)
    low, high = table["held_out"].quantile([0.05, 0.95])
    medians = table.median().to_dict()
    return {"held_out": medians.pop("held_out"), "low": low, "high": high, **medians}


def sentence(table: pd.DataFrame) -> str:
    """What `judge` found, for a person: the law where it beats the free means on everything, else
    that the misfit stays unexplained."""
    rows = table.set_index("law")
    owner, turned, means = rows.iloc[0], rows.iloc[1], rows.iloc[2]
    plain, law = rows.loc["return through ground"], rows.iloc[-1]
    where = (
        f"The owner's simulation leaves {owner.held_out:.2f} of |v| on drives and frames left out."
    )
    held = (
        f"{int(plain.numbers)} numbers leave {plain.held_out:.3f}, a gain a measuring pair besides "
        f"{law.held_out:.3f} ({int(means.numbers)} free means over rotations {means.held_out:.3f}, "
        f"with the gains {rows.iloc[3].held_out:.3f}); they have {percent(law.reversal_explained)} "
        f"of what reversal changes (the means {percent(means.reversal_explained)}) and "
        f"{percent(law.drift_explained)} of the drift ({percent(means.drift_explained)}, with the "
        f"gains {percent(rows.iloc[3].drift_explained)}); touches, to which "
        f"nothing was fitted, correlate by {law.touch_correlation:.2f} in the median channel (the "
        f"owner's simulation {owner.touch_correlation:.2f}, with its electrodes half a pitch on "
        f"{turned.touch_correlation:.2f})"
    )
    better = (
        law.held_out < means.held_out
        and law.reversal_explained > max(means.reversal_explained, PREDICTED)
        and law.drift_explained > max(means.drift_explained, PREDICTED)
        and law.touch_correlation > max(owner.touch_correlation, turned.touch_correlation)
    )
    if not better:
        return f"{where} Unexplained. Current that comes back through ground does not do: {held}."
    return (
        f"{where} Law: the source drives against ground and every electrode leaks to it, the sink "
        f"taking {percent(law.through_sink)} of the current, and common mode enters readings "
        f"{law.common_mode:+.2f} fold with a constant added: {held}. The rest, {law.held_out:.2f} "
        "of |v|, differs from drive to drive and is unexplained. The law's form was chosen on a "
        "recording of this kind, so another skin has to confirm it."
    )
