"""Physics outside the catalogue.

Each law's docstring states its effect; `amount` is its strength, 0 for none, chosen by its SNR.
`draw(rng, scene)` draws a law, which acts through the hooks that it overrides.
"""

from dataclasses import dataclass, field, fields
from typing import ClassVar, Protocol, Self

import numpy as np
from scipy.special import erfc

from eitskin.physics.skin import Skin
from witness.boundary import Disc


@dataclass
class Touches:
    """The state of the skin in each of R rows. All (R,); z (R, n) ohm m2; sigma (R,) S/m.

    inclusions: {row: [(Disc, contrast)]}, beside the touch; layers: {row: (radii mm, relative
    conductivities)}, of a touch that is not sharp; dent: the share of the depth touches reach.
    """

    touched: np.ndarray
    place: np.ndarray
    radius_mm: np.ndarray
    contrast: np.ndarray
    force: np.ndarray
    minutes: np.ndarray
    press: np.ndarray
    z: np.ndarray
    sigma: np.ndarray
    siemens: np.ndarray
    inclusions: dict[int, list[tuple[Disc, float]]] = field(default_factory=dict)
    layers: dict[int, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    dent: float = 1.0


class Asked(Protocol):
    """The attributes of the world that laws use; drives (D, 2)."""

    skin: Skin
    channels: np.ndarray
    drives: np.ndarray
    frame_s: float


@dataclass(frozen=True)
class Scene:
    """The scene of a law: electrodes, presses, the recording's end, the skin's radius, a disc that
    is never touched (x, y, radius, mm), and the untouched frame (M,) V."""

    n_electrodes: int
    presses: np.ndarray
    end_s: float
    radius_mm: float
    free: tuple[float, float, float] | None
    untouched_V: np.ndarray


@dataclass(frozen=True)
class Outside:
    """A law without effect; laws override its hooks, which are called in their order.

    keeps_clear: whether the law acts in the scene's free disc, which must not be touched.
    """

    amount: float = 0.0
    keeps_clear: ClassVar[bool] = False
    max_amount: ClassVar[float] = 1.0

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        """The law at its largest amount, with its other values drawn."""
        return cls(amount=cls.max_amount)

    def parameters(self) -> dict:
        """The values by name."""
        return {value_field.name: getattr(self, value_field.name) for value_field in fields(self)}

    def touch(self, rows: Touches, world: Asked) -> None:
        """Change the rows in place."""

    def network(self, admittance: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        """Admittance (R, n, n) S between the electrodes."""
        return admittance

    def board(self, potential: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        """Potentials (R, D, n) V per A at the board."""
        return potential

    def pairs(
        self, volt: np.ndarray, admittance: np.ndarray, rows: Touches, world: Asked
    ) -> np.ndarray:
        """Differences (R, M) V per A at the amplifiers' inputs."""
        return volt

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        """Readings (R, M) V after them."""
        return volt


@dataclass(frozen=True)
class IntermittentContact(Outside):
    """One electrode's z is (1 + amount) times as large throughout some of the presses."""

    electrode: int = 0
    presses: tuple[int, ...] = ()
    max_amount: ClassVar[float] = 30.0

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        some = rng.choice(scene.presses, max(2, len(scene.presses) // 3), replace=False)
        return cls(
            cls.max_amount, int(rng.integers(scene.n_electrodes)), tuple(sorted(some.tolist()))
        )

    def touch(self, rows: Touches, world: Asked) -> None:
        rows.z[np.isin(rows.press, self.presses), self.electrode] *= 1.0 + self.amount


@dataclass(frozen=True)
class GainRange(Outside):
    """Readings beyond a threshold are taken in another range, (1 + amount) times as sensitive."""

    threshold_V: float = 1.0
    max_amount: ClassVar[float] = 0.3

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(
            cls.max_amount, float(np.quantile(np.abs(scene.untouched_V), rng.uniform(0.4, 0.8)))
        )

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        return volt * np.where(np.abs(volt) > self.threshold_V, 1.0 + self.amount, 1.0)


@dataclass(frozen=True)
class HumidityStep(Outside):
    """The conductivity is (1 + amount) times as large from one moment on."""

    minutes: float = 0.0
    max_amount: ClassVar[float] = 0.5

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(cls.max_amount, float(scene.end_s / 60.0 * rng.uniform(0.3, 0.7)))

    def touch(self, rows: Touches, world: Asked) -> None:
        rows.sigma[rows.minutes > self.minutes] *= 1.0 + self.amount


@dataclass(frozen=True)
class SmoothDent(Outside):
    """contrast erfc((r - a) / sqrt(2) w) / 2 in place of a sharp disc of radius a; w = amount a."""

    max_amount: ClassVar[float] = 0.3
    rings: ClassVar[int] = 40

    def touch(self, rows: Touches, world: Asked) -> None:
        for row in np.flatnonzero(rows.touched & (rows.contrast != 0)):
            radius, width = rows.radius_mm[row], max(self.amount, 1e-3) * rows.radius_mm[row]
            ends = np.linspace(max(radius - 3.5 * width, 0.0), radius + 3.5 * width, self.rings + 1)
            middle = 0.5 * (ends[1:] + ends[:-1])
            profile = 0.5 * erfc((middle - radius) / (np.sqrt(2.0) * width))
            outer, relative = ends[1:], 1.0 + rows.contrast[row] * profile
            if ends[0] > 0:
                outer = np.append(ends[0], outer)
                relative = np.append(1.0 + rows.contrast[row], relative)
            rows.layers[int(row)] = (outer, relative)


@dataclass(frozen=True)
class Palm(Outside):
    """A second contact, of contrast amount, that nobody reports, lies on the skin in some
    presses."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    radius_mm: float = 5.0
    presses: tuple[int, ...] = ()
    keeps_clear: ClassVar[bool] = True
    max_amount: ClassVar[float] = 5.0

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        assert scene.free is not None
        some = rng.choice(scene.presses, max(3, len(scene.presses) // 2), replace=False)
        return cls(cls.max_amount, *scene.free, tuple(sorted(some.tolist())))

    def touch(self, rows: Touches, world: Asked) -> None:
        palm = (Disc(self.x_mm, self.y_mm, self.radius_mm), self.amount)
        for row in np.flatnonzero(np.isin(rows.press, self.presses)):
            rows.inclusions[int(row)] = [*rows.inclusions.get(int(row), []), palm]


@dataclass(frozen=True)
class Shunt(Outside):
    """The touch bridges the two electrodes nearest to it: amount F exp(-(d / range)^2) S, d from
    the touch to the middle between them."""

    range_mm: float = 20.0
    max_amount: ClassVar[float] = 0.1

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(cls.max_amount, float(scene.radius_mm * rng.uniform(0.25, 0.5)))

    def network(self, admittance: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        deg, radius = world.skin.electrode_deg, world.skin.radius_mm
        assert deg is not None and radius is not None
        rim = radius * np.exp(1j * np.radians(deg))
        middle = 0.5 * (rim + np.roll(rim, -1))
        admittance = admittance.copy()
        for row in np.flatnonzero(rows.touched):
            distance = np.abs(middle - rows.place[row])
            a = int(distance.argmin())
            ends = np.array([a, (a + 1) % len(rim)])
            bridge = self.amount * rows.force[row] * np.exp(-((distance[a] / self.range_mm) ** 2))
            admittance[row, ends[:, None], ends] += bridge * np.array([[1, -1], [-1, 1]])
        return admittance


@dataclass(frozen=True)
class Slit(Outside):
    """A row of four pinholes, 1.2 mm in radius, 4 mm apart, conducts amount less than the skin."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    deg: float = 0.0
    keeps_clear: ClassVar[bool] = True
    max_amount: ClassVar[float] = 0.999

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        assert scene.free is not None
        x, y, _ = scene.free
        return cls(cls.max_amount, x, y, float(rng.uniform(0.0, 180.0)))

    def touch(self, rows: Touches, world: Asked) -> None:
        along = 4.0 * (np.arange(4) - 1.5) * np.exp(1j * np.radians(self.deg))
        places = complex(self.x_mm, self.y_mm) + along
        holes = [(Disc(float(p.real), float(p.imag), 1.2), -self.amount) for p in places]
        for row in range(len(rows.touched)):
            rows.inclusions[row] = [*rows.inclusions.get(row, []), *holes]


@dataclass(frozen=True)
class SourceSag(Outside):
    """The current falls with the load: 1 / (1 + amount load / mean load), the load being what
    source and sink see."""

    max_amount: ClassVar[float] = 0.5

    def board(self, potential: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        drive_index = np.arange(len(world.drives))
        load = (
            potential[:, drive_index, world.drives[:, 0]]
            - potential[:, drive_index, world.drives[:, 1]]
        )
        return potential / (1.0 + self.amount * load / load[0].mean())[:, :, None]


@dataclass(frozen=True)
class InputCurrent(Outside):
    """The amplifier's two inputs each draw amount / (1 kohm) of their potential above the sink."""

    max_amount: ClassVar[float] = 1.0

    def pairs(
        self, volt: np.ndarray, admittance: np.ndarray, rows: Touches, world: Asked
    ) -> np.ndarray:
        n = admittance.shape[-1]
        impedance = np.linalg.inv(admittance + np.abs(admittance).max() / n)
        source, sink, plus, minus = world.channels.T
        load = 1e-3 * self.amount

        def above(i: np.ndarray, j: np.ndarray) -> np.ndarray:
            """(R, M): potential of i above the sink for a unit current from j to the sink."""
            r = impedance
            return r[:, i, j] - r[:, i, sink] - r[:, sink, j] + r[:, sink, sink]

        a, d = 1.0 + load * above(plus, plus), 1.0 + load * above(minus, minus)
        b = load * above(plus, minus)
        high, low = above(plus, source), above(minus, source)
        return ((d + b) * high - (a + b) * low) / (a * d - b * b)


@dataclass(frozen=True)
class Texture(Outside):
    """The touch's contrast varies over the skin: (1 + amount cos(2 pi (r . n) / pitch + phase))."""

    pitch_mm: float = 40.0
    deg: float = 0.0
    phase: float = 0.0
    max_amount: ClassVar[float] = 0.9

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        pitch = scene.radius_mm * rng.uniform(0.4, 1.0)
        return cls(cls.max_amount, float(pitch), *rng.uniform(0.0, (360.0, 2.0 * np.pi)).tolist())

    def touch(self, rows: Touches, world: Asked) -> None:
        along = (rows.place * np.exp(-1j * np.radians(self.deg))).real
        wave = np.cos(2.0 * np.pi * along / self.pitch_mm + self.phase)
        rows.contrast[:] = rows.contrast * (1.0 + self.amount * wave)


@dataclass(frozen=True)
class ProbeTilt(Outside):
    """The contact's centre walks along one direction by amount mm per N."""

    deg: float = 0.0
    max_amount: ClassVar[float] = 0.3

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(cls.max_amount, float(rng.uniform(0.0, 360.0)))

    def touch(self, rows: Touches, world: Asked) -> None:
        walk = self.amount * rows.force * np.exp(1j * np.radians(self.deg))
        rows.place[:] = np.where(rows.touched, rows.place + walk, rows.place)


@dataclass(frozen=True)
class ThermalGain(Outside):
    """All gains swing by amount with a period: 1 + amount sin(2 pi t / period)."""

    period_s: float = 60.0
    phase: float = 0.0
    max_amount: ClassVar[float] = 0.3

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        period = scene.end_s * rng.uniform(0.15, 0.5)
        return cls(cls.max_amount, float(period), float(rng.uniform(0.0, 2.0 * np.pi)))

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        angle = 120.0 * np.pi * rows.minutes / self.period_s + self.phase
        return volt * (1.0 + self.amount * np.sin(angle))[:, None]


@dataclass(frozen=True)
class EvenConverter(Outside):
    """v + amount v^2 / v0, v0 the largest untouched reading."""

    reference_V: float = 1.0
    max_amount: ClassVar[float] = 0.3

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(cls.max_amount, float(np.abs(scene.untouched_V).max()))

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        return volt + self.amount * volt**2 / self.reference_V


@dataclass(frozen=True)
class SlowSettling(Outside):
    """Part of the reading before last is in each: (1 - amount) v_k + amount v_(k-2), cyclic."""

    max_amount: ClassVar[float] = 0.3

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        return (1.0 - self.amount) * volt + self.amount * np.roll(volt, 2, axis=1)


@dataclass(frozen=True)
class ContactThreshold(Outside):
    """One electrode's z is (1 + amount) times as large while the force is above a threshold."""

    electrode: int = 0
    force_N: float = 5.0
    max_amount: ClassVar[float] = 30.0

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        electrode = int(rng.integers(scene.n_electrodes))
        return cls(cls.max_amount, electrode, float(rng.uniform(2.5, 5.0)))

    def touch(self, rows: Touches, world: Asked) -> None:
        rows.z[rows.force > self.force_N, self.electrode] *= 1.0 + self.amount


@dataclass(frozen=True)
class WanderingGain(Outside):
    """The gain of all channels walks at random: its steps from frame to frame, of sd amount / 10,
    are normal."""

    seed: int = 0
    max_amount: ClassVar[float] = 0.5

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(cls.max_amount, int(rng.integers(2**31)))

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        step = np.random.default_rng(self.seed).standard_normal(len(volt))
        return volt * (1.0 + 0.1 * self.amount * np.cumsum(step))[:, None]


@dataclass(frozen=True)
class LateGain(Outside):
    """From one moment on one measuring pair reads (1 + amount) times as much: a loose plug."""

    measure: int = 0
    minutes: float = 0.0
    max_amount: ClassVar[float] = 0.5

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        measure = int(rng.integers(scene.n_electrodes))
        return cls(cls.max_amount, measure, float(scene.end_s / 60.0 * rng.uniform(0.3, 0.7)))

    def converted(self, volt: np.ndarray, rows: Touches, world: Asked) -> np.ndarray:
        mine = world.channels[:, 2] == self.measure
        late = (rows.minutes > self.minutes)[:, None] & mine
        return volt * np.where(late, 1.0 + self.amount, 1.0)


@dataclass(frozen=True)
class LastingDent(Outside):
    """After a press its dent stays: amount of its last contrast, fading with exp(-t / tau), until
    the next press begins."""

    tau_s: float = 10.0
    max_amount: ClassVar[float] = 0.9

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(cls.max_amount, float(rng.uniform(3.0, 20.0)))

    def touch(self, rows: Touches, world: Asked) -> None:
        latest_press = None
        for row, touched in enumerate(rows.touched):
            if touched:
                place, radius = rows.place[row], rows.radius_mm[row]
                disc = Disc(float(place.real), float(place.imag), float(radius))
                latest_press = disc, rows.contrast[row], rows.minutes[row]
            elif latest_press is not None:
                fade = np.exp(-60.0 * (rows.minutes[row] - latest_press[2]) / self.tau_s)
                residual_dent = (latest_press[0], float(self.amount * latest_press[1] * fade))
                rows.inclusions[row] = [*rows.inclusions.get(row, []), residual_dent]


@dataclass(frozen=True)
class ShallowDent(Outside):
    """The touch reaches down through 1 - amount of the depth alone and changes what it reaches by
    so much more that the sheet's conductance changes as it would; its strength is drawn."""

    max_amount: ClassVar[float] = 0.7

    @classmethod
    def draw(cls, rng: np.random.Generator, scene: Scene) -> Self:
        return cls(round(float(rng.uniform(0.3, cls.max_amount)), 3))

    def touch(self, rows: Touches, world: Asked) -> None:
        rows.dent = 1.0 - self.amount
        rows.contrast[:] = rows.contrast / rows.dent


OUTSIDE: dict[str, type[Outside]] = {
    "intermittent-contact": IntermittentContact,
    "gain-range": GainRange,
    "humidity-step": HumidityStep,
    "smooth-dent": SmoothDent,
    "palm": Palm,
    "shunt": Shunt,
    "slit": Slit,
    "source-sag": SourceSag,
    "input-current": InputCurrent,
    "texture": Texture,
    "probe-tilt": ProbeTilt,
    "thermal-gain": ThermalGain,
    "even-converter": EvenConverter,
    "slow-settling": SlowSettling,
    "contact-threshold": ContactThreshold,
    "wandering-gain": WanderingGain,
    "late-gain": LateGain,
    "lasting-dent": LastingDent,
}

# Laws of bodies in three dimensions, without effect on a sheet.
OUTSIDE_SOLID: dict[str, type[Outside]] = {"shallow-dent": ShallowDent}
