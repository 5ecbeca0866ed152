"""More physics outside the catalogue, excluded from every calibration.

Laws as in `witness.outside`, on which nothing was tuned or diagnosed while the diagnosis was being
written: they are for a last, sealed block.
"""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from witness import laws as catalogue
from witness.boundary import Disc
from witness.outside import Asked, Outside, Scene, Touches


def _seconds(rows: Touches) -> np.ndarray:
    return 60.0 * rows.minutes


def _largest_so_far(rows: Touches) -> np.ndarray:
    """(R,) N: the running maximum of the force within each press, 0 where untouched."""
    largest = np.zeros(len(rows.force))
    for label in np.unique(rows.press[rows.press >= 0]):
        mine = np.flatnonzero(rows.press == label)
        largest[mine] = np.maximum.accumulate(rows.force[mine])
    return largest


def _latest_press(press: np.ndarray) -> np.ndarray:
    """(R,): the number of the latest press that has begun; before the first, one less than it."""
    latest_press = np.maximum.accumulate(press)
    first_press = press[press >= 0].min() if (press >= 0).any() else 0
    return np.where(latest_press < 0, first_press - 1, latest_press)


def _between(values: np.ndarray, world: Asked) -> np.ndarray:
    """(..., M): the differences of electrodes' values (..., n) over the measuring pairs."""
    return values[..., world.channels[:, 2]] - values[..., world.channels[:, 3]]


@dataclass(frozen=True)
class ChargeUp(Outside):
    """An electrode keeps a polarisation after it has carried current: +e as source, -e as sink,
    e = amount v0, whatever the current (it saturates), fading by exp(-1 / readings) a reading; all
    are discharged between frames (Dahlin 2000, Geophysics 65, 1181). v0: the untouched median."""

    readings: float = 30.0
    reference_V: float = 1.0
    max_amount: ClassVar[float] = 1.0

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        median = float(np.median(np.abs(scene.untouched_V)))
        return cls(cls.max_amount, float(rng.uniform(5.0, 60.0)), median)

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        charge = np.zeros((len(world.channels), int(world.channels.max()) + 1))
        polarisation = charge[0].copy()
        for k, (source, sink) in enumerate(world.channels[:, :2]):
            polarisation *= np.exp(-1.0 / self.readings)
            polarisation[[source, sink]] = 1.0, -1.0
            charge[k] = polarisation
        channel_index = np.arange(len(charge))
        pair_polarisation = (
            charge[channel_index, world.channels[:, 2]]
            - charge[channel_index, world.channels[:, 3]]
        )
        return volt + self.amount * self.reference_V * pair_polarisation


@dataclass(frozen=True)
class DryingFront(Outside):
    """A ring at the rim conducts amount less; its depth grows as the root of time, as diffusion
    does: depth sqrt((t + T / 4) / (5 T / 4)), T the recording's length; within a press it stays."""

    depth_mm: float = 8.0
    end_s: float = 100.0
    max_amount: ClassVar[float] = 0.6

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(cls.max_amount, float(scene.radius_mm * rng.uniform(0.15, 0.25)), scene.end_s)

    def touch(self, rows: Touches, world: Asked) -> None:
        time, radius = _seconds(rows), world.skin.radius_mm
        assert radius is not None
        for label in np.unique(rows.press[rows.press >= 0]):
            time[rows.press == label] = time[rows.press == label][0]
        depth = self.depth_mm * np.sqrt((time + 0.25 * self.end_s) / (1.25 * self.end_s))
        rows.sigma[:] = rows.sigma * (1.0 - self.amount)
        wet = self.amount / (1.0 - self.amount)
        if wet > 0:
            for row, ring in enumerate(depth.tolist()):
                disc = Disc(0.0, 0.0, radius - ring)
                rows.inclusions[row] = [*rows.inclusions.get(row, []), (disc, wet)]


@dataclass(frozen=True)
class Peeling(Outside):
    """Under load the rim peels off, electrode by electrode from one on: the j-th's z is
    (1 + amount min(max((F* - threshold) / step - j, 0), 1)) times as large, F* the largest force of
    the press so far; it lies down again when the press ends."""

    electrode: int = 0
    turn: int = 1
    threshold_N: float = 1.0
    step_N: float = 1.0
    max_amount: ClassVar[float] = 30.0

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        electrode, turn = int(rng.integers(scene.n_electrodes)), int(rng.choice([-1, 1]))
        threshold, step = rng.uniform((0.5, 0.8), (2.0, 2.0)).tolist()
        return cls(cls.max_amount, electrode, turn, threshold, step)

    def touch(self, rows: Touches, world: Asked) -> None:
        n = rows.z.shape[1]
        length = (_largest_so_far(rows) - self.threshold_N) / self.step_N
        order = (self.electrode + self.turn * np.arange(n)) % n
        lifted = np.clip(length[:, None] - np.arange(n), 0.0, 1.0)
        rows.z[:, order] *= 1.0 + self.amount * lifted


@dataclass(frozen=True)
class Bubble(Outside):
    """An air bubble under the skin, that conducts amount less, is elsewhere after each press: even
    in a disc about a place that nothing touches."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    reach_mm: float = 5.0
    radius_mm: float = 2.5
    seed: int = 0
    keeps_clear: ClassVar[bool] = True
    max_amount: ClassVar[float] = 0.999

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        assert scene.free is not None
        x, y, clear = scene.free
        radius = float(rng.uniform(1.5, 3.0))
        return cls(cls.max_amount, x, y, clear - radius, radius, int(rng.integers(2**31)))

    def place(self, press: int) -> complex:
        """The bubble's place from a press on, mm."""
        u, phi = np.random.default_rng([self.seed, press + 1]).uniform(size=2)
        displacement = self.reach_mm * np.sqrt(u) * np.exp(2j * np.pi * phi)
        return complex(self.x_mm, self.y_mm) + complex(displacement)

    def touch(self, rows: Touches, world: Asked) -> None:
        for row, press in enumerate(_latest_press(rows.press).tolist()):
            bubble_mm = self.place(press)
            hole = (Disc(bubble_mm.real, bubble_mm.imag, self.radius_mm), -self.amount)
            rows.inclusions[row] = [*rows.inclusions.get(row, []), hole]


@dataclass(frozen=True)
class LeadCoupling(Outside):
    """Neighbouring leads couple through a stray capacitance when the drive is switched: each lead
    takes amount / 2 of the step of either neighbour's potential above the sink, fading by
    exp(-1 / readings) a reading."""

    readings: float = 3.0
    max_amount: ClassVar[float] = 0.3

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(cls.max_amount, float(rng.uniform(1.0, 8.0)))

    def pairs(
        self, volt: np.ndarray, admittance: np.ndarray, rows: Touches, world: Asked
    ) -> np.ndarray:
        ends = world.channels[:, :2]
        is_first = np.append(True, (ends[1:] != ends[:-1]).any(axis=1))
        reading_number = np.arange(len(ends)) - np.flatnonzero(is_first)[np.cumsum(is_first) - 1]
        drives, block = ends[is_first], np.cumsum(is_first) - 1
        potential = catalogue.potentials([], admittance, rows.siemens > 0, drives, False)
        potential = potential - potential[:, np.arange(len(drives)), drives[:, 1]][..., None]
        step = potential - np.roll(potential, 1, axis=1)
        pushed = 0.5 * (np.roll(step, 1, axis=2) + np.roll(step, -1, axis=2))[:, block]
        channel_index = np.arange(len(ends))
        pair_coupling = (
            pushed[:, channel_index, world.channels[:, 2]]
            - pushed[:, channel_index, world.channels[:, 3]]
        )
        return volt + self.amount * np.exp(-reading_number / self.readings) * pair_coupling


@dataclass(frozen=True)
class WarmingPatch(Outside):
    """A lamp warms a place that nothing touches: a disc conducts
    1 + amount (1 - exp(-t / tau)) times as well."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    radius_mm: float = 8.0
    tau_s: float = 60.0
    keeps_clear: ClassVar[bool] = True
    max_amount: ClassVar[float] = 2.0

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        assert scene.free is not None
        return cls(cls.max_amount, *scene.free, float(scene.end_s * rng.uniform(0.1, 0.5)))

    def touch(self, rows: Touches, world: Asked) -> None:
        warmth = -np.expm1(-_seconds(rows) / self.tau_s)
        for row, contrast in enumerate((self.amount * warmth).tolist()):
            warm = (Disc(self.x_mm, self.y_mm, self.radius_mm), contrast)
            rows.inclusions[row] = [*rows.inclusions.get(row, []), warm]


@dataclass(frozen=True)
class SteppedGain(Outside):
    """The amplifier sets its range drive by drive: where the largest reading of the drive before,
    round the frame, is under a level, the next drive's readings are (1 + amount) times as large."""

    level_V: float = 1.0
    max_amount: ClassVar[float] = 0.3

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(
            cls.max_amount, float(np.abs(scene.untouched_V).max() * (1 - rng.uniform(0.001, 0.02)))
        )

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        ends = world.channels[:, :2]
        is_first = np.append(True, (ends[1:] != ends[:-1]).any(axis=1))
        largest = np.maximum.reduceat(np.abs(volt), np.flatnonzero(is_first), axis=1)
        low = np.roll(largest, 1, axis=1) < self.level_V
        return volt * np.where(low, 1.0 + self.amount, 1.0)[:, np.cumsum(is_first) - 1]


@dataclass(frozen=True)
class ProbeSlip(Outside):
    """Once a press gets lighter its probe slips, by amount mm, another way in each press, and stays
    there till it lifts."""

    seed: int = 0
    max_amount: ClassVar[float] = 3.0

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(cls.max_amount, int(rng.integers(2**31)))

    def touch(self, rows: Touches, world: Asked) -> None:
        eased = rows.touched & (rows.force < _largest_so_far(rows))
        for label in np.unique(rows.press[eased]):
            mine = np.flatnonzero(rows.press == label)
            slipped = mine[np.argmax(eased[mine]) :]
            way = np.random.default_rng([self.seed, label]).uniform(0.0, 2.0 * np.pi)
            rows.place[slipped] += self.amount * np.exp(1j * way)


@dataclass(frozen=True)
class SupplyRipple(Outside):
    """The supply's ripple modulates the source: each reading is 1 + amount sin(2 pi f t + phase)
    times as large at the moment it is read."""

    frequency_Hz: float = 100.0
    phase: float = 0.0
    max_amount: ClassVar[float] = 0.3

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        tone = float(rng.choice([100.0, 120.0]) + rng.uniform(-0.1, 0.1))
        return cls(cls.max_amount, tone, float(rng.uniform(0.0, 2.0 * np.pi)))

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        count = volt.shape[1]
        moment = _seconds(rows)[:, None] + world.frame_s * np.arange(count) / count
        angle = 2.0 * np.pi * self.frequency_Hz * moment + self.phase
        return volt * (1.0 + self.amount * np.sin(angle))


@dataclass(frozen=True)
class PopcornNoise(Outside):
    """One amplifier jumps between two levels, amount v0 apart, and stays at each for times that are
    exponentially distributed: burst noise. v0: the untouched median."""

    measure: int = 0
    dwell_s: float = 10.0
    reference_V: float = 1.0
    seed: int = 0
    max_amount: ClassVar[float] = 3.0
    jumps: ClassVar[int] = 4096

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        measure, seed = int(rng.integers(scene.n_electrodes)), int(rng.integers(2**31))
        dwell = float(scene.end_s * rng.uniform(0.03, 0.15))
        return cls(
            cls.max_amount, measure, dwell, float(np.median(np.abs(scene.untouched_V))), seed
        )

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        waits = np.random.default_rng(self.seed).exponential(self.dwell_s, self.jumps)
        high = np.searchsorted(np.cumsum(waits), _seconds(rows)) % 2
        mine = world.channels[:, 2] == self.measure
        return volt + self.amount * self.reference_V * high[:, None] * mine


@dataclass(frozen=True)
class HalfCellDrift(Outside):
    """Every electrode's half-cell potential creeps to a value of its own:
    amount v0 d_l (1 - exp(-t / tau)). v0: the untouched median."""

    tau_s: float = 60.0
    reference_V: float = 1.0
    ends: tuple[float, ...] = ()
    max_amount: ClassVar[float] = 1.0

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        ends = tuple(np.round(rng.standard_normal(scene.n_electrodes), 3).tolist())
        median = float(np.median(np.abs(scene.untouched_V)))
        return cls(cls.max_amount, float(scene.end_s * rng.uniform(0.1, 0.5)), median, ends)

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        crept = -np.expm1(-_seconds(rows) / self.tau_s)
        pair_potential = self.amount * self.reference_V * _between(np.array(self.ends), world)
        return volt + crept[:, None] * pair_potential


@dataclass(frozen=True)
class AveragingFilter(Outside):
    """The board smooths over frames: y_n = (1 - amount) v_n + amount y_(n-1), from y_0 = v_0."""

    max_amount: ClassVar[float] = 0.9

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        smooth = volt.copy()
        for n in range(1, len(volt)):
            smooth[n] = (1.0 - self.amount) * volt[n] + self.amount * smooth[n - 1]
        return smooth


@dataclass(frozen=True)
class PileUp(Outside):
    """Gel that a touch displaces piles up around it: a ring from its edge a to 1.3 a conducts
    amount c a^2 / (1.69 a^2 - a^2) less, c the contrast within; never below a tenth."""

    ratio: ClassVar[float] = 1.3
    max_amount: ClassVar[float] = 0.5

    def touch(self, rows: Touches, world: Asked) -> None:
        for row in np.flatnonzero(rows.touched & (rows.contrast != 0)):
            radius, contrast = rows.radius_mm[row], rows.contrast[row]
            ring = max(1.0 - self.amount * contrast / (self.ratio**2 - 1.0), 0.1)
            radii = radius * np.array([1.0, self.ratio])
            rows.layers[int(row)] = (radii, np.array([1.0 + contrast, ring]))


UNSEEN: dict[str, type[Outside]] = {
    "charge-up": ChargeUp,
    "drying-front": DryingFront,
    "peeling": Peeling,
    "bubble": Bubble,
    "lead-coupling": LeadCoupling,
    "warming-patch": WarmingPatch,
    "stepped-gain": SteppedGain,
    "probe-slip": ProbeSlip,
    "supply-ripple": SupplyRipple,
    "popcorn-noise": PopcornNoise,
    "half-cell-drift": HalfCellDrift,
    "averaging-filter": AveragingFilter,
    "pile-up": PileUp,
}
