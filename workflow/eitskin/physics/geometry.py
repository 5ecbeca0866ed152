"""The shape of a skin: its rim, where its electrodes lie, how its conductivity is directed."""

import copy
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from eitskin.errors import InputError
from eitskin.physics import outline
from eitskin.physics.arrays import as_in
from eitskin.physics.rim_curve import EVEN_POINTS, RimCurve, distance, inside
from eitskin.physics.skin import Skin

ROUND_POINTS = 256  # of a sampled round rim: more than twice the conformal map's degree
DRAWN_POLES = 8  # of corners of a rim that has moved, where places are sought within it
CORNER_CLEARANCE = 1e-3  # radians of the rim's length between a point electrode and a corner
RIM = {
    *("radius_mm", "shape_cos", "shape_sin", "stretch_x", "stretch_y"),
    *("anisotropy_ratio", "anisotropy_deg", "outline"),
}
MATERIAL = ("thickness_mm", "conductivity_S_per_m", "contact_impedivity_ohm_m2")


@dataclass(frozen=True)
class Patch:
    """A disc of the skin, centre and radius in mm, whose conductivity is multiplied by `contrast`.

    Raises InputError for a radius or a contrast of 0 or less.
    """

    x_mm: float
    y_mm: float
    radius_mm: float
    contrast: float

    def __post_init__(self) -> None:
        for name in ("radius_mm", "contrast"):
            if not getattr(self, name) > 0:
                raise InputError("patch", name, getattr(self, name), "more than 0")

    @property
    def centre(self) -> complex:
        """x + i y, mm."""
        return complex(self.x_mm, self.y_mm)


@dataclass(frozen=True)
class Geometry:
    """A conductive sheet with electrodes on its rim, in the units of its names.

    The rim is r(phi) = radius (1 + sum_k shape_cos[k] cos k phi + shape_sin[k] sin k phi),
    stretched by (x, y) -> (stretch_x x, stretch_y y), electrodes and all. Of an `outline` phi is
    the share of its length, `radius_mm` that length over 2 pi, and the sum moves the rim along its
    normal, by sqrt(area / pi) where it is 1. An electrode spans the angles electrode_deg +- width /
    (2 radius); width 0 makes it a point. Conductivity along `anisotropy_deg` over that across is
    `anisotropy_ratio`, geometric mean `conductivity_S_per_m`; it rises towards `gradient_deg` by
    `gradient_across` of itself from rim to rim; each of the `patches` multiplies it within a disc.
    electrode_inside_mm (n,) complex: before the stretch, the centre of each electrode inside the
    skin, a disc as wide as the electrode; NaN of those on the rim, None where all are. The angle of
    an electrode inside is of no effect.
    Raises InputError for values that make no skin.
    """

    radius_mm: float
    thickness_mm: float
    conductivity_S_per_m: float
    electrode_deg: np.ndarray
    electrode_width_mm: np.ndarray
    contact_impedivity_ohm_m2: np.ndarray
    shape_cos: dict[int, float] = field(default_factory=dict)
    shape_sin: dict[int, float] = field(default_factory=dict)
    stretch_x: float = 1.0
    stretch_y: float = 1.0
    anisotropy_ratio: float = 1.0
    anisotropy_deg: float = 0.0
    gradient_across: float = 0.0
    gradient_deg: float = 0.0
    electrode_height_mm: float | None = None
    electrode_z_mm: float | None = None
    deep: bool = False
    patches: tuple[Patch, ...] = ()
    outline: RimCurve | None = None
    electrode_inside_mm: np.ndarray | None = None

    def __post_init__(self) -> None:
        angle = np.asarray(self.electrode_deg, dtype=float)
        object.__setattr__(self, "electrode_deg", angle)
        self._set_inside()
        for name in ("electrode_width_mm", "contact_impedivity_ohm_m2"):
            value = np.broadcast_to(np.asarray(getattr(self, name), float), angle.shape).copy()
            if not (value >= 0).all():
                raise InputError("skin", name, value.min(), "0 or more")
            object.__setattr__(self, name, value)
        points = self.electrode_width_mm == 0
        if points.any() and not points.all():
            raise InputError("skin", "electrode_width_mm", "0 and more", "all 0 or none")
        for name in ("radius_mm", "thickness_mm", "conductivity_S_per_m", "anisotropy_ratio"):
            if not getattr(self, name) > 0:
                raise InputError("skin", name, getattr(self, name), "more than 0")
        if self.has_rim:
            self._refuse_overlap(self.on_rim)
        if not points.any() and not (self.contact_impedivity_ohm_m2 > 0).all():
            raise InputError("skin", "contact_impedivity_ohm_m2", 0, "more than 0 (width > 0)")
        if self.outline:
            self._refuse_on_outlines()
        if self.electrode_inside_mm is not None:
            self._refuse_inside()

    def _set_inside(self) -> None:
        """Set the places inside as a complex array; None where all electrodes are on the rim."""
        if self.electrode_inside_mm is None:
            return
        place = np.asarray(self.electrode_inside_mm, complex)
        if place.shape != self.electrode_deg.shape:
            expected = f"{self.electrode_deg.shape}, one an electrode"
            raise InputError("skin", "electrode_inside_mm", place.shape, expected)
        inside = None if np.isnan(place).all() else place
        object.__setattr__(self, "electrode_inside_mm", inside)

    def _refuse_overlap(self, numbers: np.ndarray) -> None:
        """Raise InputError where electrodes of the rim, by their numbers, overlap."""
        angle = self.electrode_deg[numbers] % 360.0
        order = np.argsort(angle)
        gap_deg = np.diff(np.append(angle[order], angle[order[0]] + 360.0))
        half_deg = np.degrees(self.electrode_width_mm[numbers][order] / (2.0 * self.radius_mm))
        room = gap_deg - half_deg - np.append(half_deg[1:], half_deg[0])
        if not (room > 0).all():
            raise InputError("skin", "electrodes", "two that overlap", "each an arc of its own")

    def _refuse_inside(self) -> None:
        """Raise InputError for electrodes inside that overlap or reach over the rim, and for what
        is not modelled beside them."""
        for key, none in (("anisotropy_ratio", 1.0), ("gradient_across", 0.0), ("deep", False)):
            if getattr(self, key) != none:
                expected = f"{none:g} beside electrodes inside the skin"
                raise InputError("skin", key, f"{getattr(self, key):g}", expected)
        for key in ("electrode_height_mm", "electrode_z_mm"):
            if getattr(self, key) is not None:
                expected = "none beside electrodes inside the skin"
                raise InputError("skin", key, f"{getattr(self, key):g}", expected)
        numbers, place = self.inner, self.inner_place
        radius = 0.5 * self.electrode_width_mm[numbers]
        rim = self.rim_polygon
        off = ~inside(rim, place) | ~(distance(rim, place) > radius)
        if off.any():
            number = numbers[off][0]
            at = f"({place[off][0].real:.4g}, {place[off][0].imag:.4g}) mm"
            actual = f"electrode {number}, {2.0 * radius[off][0]:g} mm wide at {at}, over the rim"
            raise InputError("skin", "electrodes", actual, "a disc within the skin")
        apart = np.abs(place[:, None] - place) - radius[:, None] - radius
        overlap = np.argwhere(np.triu(apart <= 0.0, 1))
        if len(overlap):
            actual = "electrodes {} and {}, which overlap".format(*numbers[overlap[0]])
            raise InputError("skin", "electrodes", actual, "discs apart")

    def _refuse_on_outlines(self) -> None:
        """Raise InputError for points at a corner, and for what only discs have."""
        assert self.outline is not None
        angle = np.radians(self.electrode_deg[self.on_rim])
        offset = self.outline.corner_phi[:, None] - angle
        offset = np.abs((offset + np.pi) % (2.0 * np.pi) - np.pi)
        at_corner = np.flatnonzero((offset < CORNER_CLEARANCE).any(axis=0))
        if self.points and len(at_corner):
            actual = f"electrode {self.on_rim[at_corner[0]]}, a point, at a corner"
            raise InputError("skin", "electrodes", actual, "points off the corners, or a width")
        for key in ("electrode_height_mm", "electrode_z_mm"):
            if getattr(self, key) is not None:
                actual, expected = "a depth, on a skin that is no disc", "none: bodies are discs"
                raise InputError("skin", key, actual, expected)

    @classmethod
    def from_skin(cls, skin: Skin) -> "Geometry":
        """The ideal geometry of a Skin. Raises InputError where a required key is null, and for
        one that `outline` refuses."""
        skin = outline.laid_out(skin)
        required = ["radius_mm", "thickness_mm", "conductivity_S_per_m", "electrode_deg"]
        required += ["electrode_width_mm"]
        if skin.electrode_width_mm:
            required.append("contact_impedivity_ohm_m2")
        for key in required:
            if getattr(skin, key) is None:
                raise InputError("skin", key, "null", "a value, to simulate with")
        assert skin.radius_mm is not None and skin.thickness_mm is not None
        assert skin.conductivity_S_per_m is not None
        return cls(
            skin.radius_mm,
            skin.thickness_mm,
            skin.conductivity_S_per_m,
            np.array(skin.electrode_deg),
            np.array(skin.electrode_width_mm),
            np.array(skin.contact_impedivity_ohm_m2 or 0.0),
            electrode_height_mm=skin.electrode_height_mm,
            electrode_z_mm=skin.electrode_z_mm,
            outline=skin.rim,
            electrode_inside_mm=outline.inside_mm(skin),
        )

    def with_values(self, **values: Any) -> "Geometry":
        """A copy with some fields replaced."""
        return replace(self, **values)

    def key(self, excluded: Collection[str] = ()) -> tuple:
        """A hashable key, equal for equal geometries; `excluded`: fields that it ignores."""
        values = (getattr(self, f.name) for f in fields(self) if f.name not in excluded)
        return tuple(
            value.tobytes()
            if isinstance(value, np.ndarray)
            else tuple(sorted(value.items()))
            if isinstance(value, dict)
            else value
            for value in values
        )

    def same_outline(self, geometry: "Geometry") -> bool:
        """Whether rim, places of the electrodes and direction of the conductivity agree;
        material and contacts may differ."""
        return self.key(MATERIAL) == geometry.key(MATERIAL)

    def rim_key(self) -> tuple:
        """A hashable key, equal for geometries with the same unfolded rim."""
        return self.key({f.name for f in fields(self)} - RIM)

    @property
    def points(self) -> bool:
        """Whether the electrodes are points."""
        return bool((self.electrode_width_mm == 0).all())

    @property
    def inner(self) -> np.ndarray:
        """Numbers of the electrodes inside the skin."""
        if self.electrode_inside_mm is None:
            return np.zeros(0, int)
        return np.flatnonzero(~np.isnan(self.electrode_inside_mm))

    @property
    def on_rim(self) -> np.ndarray:
        """Numbers of the electrodes on the rim."""
        return np.setdiff1d(np.arange(len(self.electrode_deg)), self.inner)

    @property
    def has_rim(self) -> bool:
        """Whether electrodes are on the rim."""
        return len(self.inner) < len(self.electrode_deg)

    @property
    def rim_part(self) -> "Geometry":
        """The skin with its electrodes on the rim alone, of which there are some."""
        if self.electrode_inside_mm is None:
            return self
        per_electrode = ("electrode_deg", "electrode_width_mm", "contact_impedivity_ohm_m2")
        values = {name: getattr(self, name)[self.on_rim] for name in per_electrode}
        return self.with_values(electrode_inside_mm=None, **values)

    @property
    def inner_place(self) -> np.ndarray:
        """(inner,) complex, mm: centres of the electrodes inside the skin."""
        if self.electrode_inside_mm is None:
            return np.zeros(0, complex)
        return self.stretch(self.electrode_inside_mm[self.inner])

    @property
    def electrode_place(self) -> np.ndarray:
        """(n,) complex, mm: middles of all electrodes."""
        place = self.rim(np.radians(self.electrode_deg))
        place[self.inner] = self.inner_place
        return place

    @property
    def sheet_resistance_ohm(self) -> float:
        """1 / (sigma h)."""
        return 1e3 / (self.conductivity_S_per_m * self.thickness_mm)

    @property
    def contact_length_mm(self) -> np.ndarray:
        """(n,): z sigma of every electrode, the length over which its contact spreads the
        current."""
        return 1e3 * self.contact_impedivity_ohm_m2 * self.conductivity_S_per_m

    def stretch(self, z: np.ndarray) -> np.ndarray:
        """(x, y) -> (stretch_x x, stretch_y y) on complex points."""
        return _axis_stretch(z, self.stretch_x, self.stretch_y)

    def unfold(self, z: np.ndarray) -> np.ndarray:
        """Coordinates, equal in area, in which the conductivity is isotropic."""
        if self.anisotropy_ratio == 1.0:
            return np.asarray(z, complex)
        squeeze = self.anisotropy_ratio**-0.25
        turn = np.exp(1j * np.radians(self.anisotropy_deg))
        return turn * _axis_stretch(z / turn, squeeze, 1.0 / squeeze)

    def rim(self, phi: np.ndarray, order: int = 0) -> np.ndarray:
        """Physical rim points, mm, complex, or their derivative by phi of `order` <= 2."""
        wave = [np.zeros(phi.shape) for _ in range(order + 1)]
        for shape, shift in ((self.shape_cos, 0.0), (self.shape_sin, -np.pi / 2)):
            for k, value in shape.items():
                for n in range(order + 1):
                    wave[n] = wave[n] + value * k**n * np.cos(k * phi + shift + n * np.pi / 2)
        return self.stretch(self._base(phi, order) + self.moved(phi, wave))

    def _base(self, phi: np.ndarray, order: int) -> np.ndarray:
        """The rim without its harmonics, not stretched, or a derivative by phi."""
        if self.outline:
            return self.outline.place(phi, order)
        return 1j**order * self.radius_mm * np.exp(1j * phi)

    def moved(self, phi: np.ndarray, wave: list[np.ndarray]) -> np.ndarray:
        """What the rim moves by, not stretched, for a displacement along its normal by `wave`
        radii; of several derivatives by phi in `wave`, the last."""
        order, rim = len(wave) - 1, self.outline
        binomial = [[1], [1, 1], [1, 2, 1]][order]
        if rim is None:
            turned = [1j ** (order - n) * np.exp(1j * phi) for n in range(order + 1)]
            size = self.radius_mm
        elif not any(map(np.any, wave)):
            return np.zeros(phi.shape, complex)
        else:
            turned = [rim.mitred_normal(phi, order - n) for n in range(order + 1)]
            size = float(np.sqrt(rim.area_mm2 / np.pi))
        terms = [binomial[n] * wave[n] * turned[n] for n in range(order + 1)]
        return size * np.sum(terms, axis=0)

    @cached_property
    def drawn_rim(self) -> np.ndarray:
        """(K,) complex, mm: corners of the rim of an outline; of a smooth one, or one that has
        moved, of the sampled rim."""
        assert self.outline is not None
        moved = self.shape_cos or self.shape_sin or (self.stretch_x, self.stretch_y) != (1.0, 1.0)
        if moved or self.outline.smooth:
            return self.rim(self.rim_phi(DRAWN_POLES)[0])
        return self.outline.points

    @property
    def rim_polygon(self) -> np.ndarray:
        """(K,) complex, mm: points of the rim, close enough to tell what lies within."""
        return self.drawn_rim if self.outline else self.rim(self.rim_phi()[0])

    @cached_property
    def corners(self) -> np.ndarray:
        """(C,) complex, mm: of an outline."""
        assert self.outline is not None
        return self.rim(self.outline.corner_phi)

    @property
    def centre(self) -> complex:
        """An unfolded place well within the rim."""
        return complex(self.unfold(np.array([self.outline.centre]))[0]) if self.outline else 0.0

    def rim_phi(
        self, corner_poles: int = 0, even_points: int = EVEN_POINTS
    ) -> tuple[np.ndarray, np.ndarray]:
        """Angles that sample the rim, ascending, and indices of corners among them; points crowd
        towards a corner as so many poles do."""
        if self.outline is None:
            return np.linspace(0.0, 2.0 * np.pi, ROUND_POINTS, endpoint=False), np.zeros(0, int)
        return self.outline.sampled_phi(corner_poles, even_points)


class Unfoldings:
    """The unfoldings of several skins, each of its own places: a z + b conj(z), as they are
    linear in (x, y). `array`: its library and device are those of the coefficients."""

    outline = None  # discs, all of them

    def __init__(self, geometries: Sequence[Geometry], array: Any):
        unit_x, unit_y = (np.array([g.unfold(np.array(z)) for g in geometries]) for z in (1.0, 1j))
        self.a, self.b = (as_in(0.5 * (unit_x + sign * 1j * unit_y), array) for sign in (-1.0, 1.0))

    def select(self, indices: Any) -> "Unfoldings":
        """Those of the skins at `indices` (P,), which may repeat."""
        selection = copy.copy(self)
        selection.a, selection.b = self.a[indices], self.b[indices]
        return selection

    def unfold(self, z: Any) -> Any:
        """Unfolded places of each skin's own places (S, ...)."""
        a, b = (v.reshape(-1, *[1] * (z.ndim - 1)) for v in (self.a, self.b))
        return a * z + b * z.conj()


def _axis_stretch(z: np.ndarray, x: float, y: float) -> np.ndarray:
    return x * np.real(z) + 1j * y * np.imag(z)


@dataclass(frozen=True)
class RimMotion:
    """How the rim and the unfolding move with one parameter, at fixed phi, per unit of it.

    rim(phi) and its slope by phi: physical, mm; unfolding(z): change of the unfolded place of z.
    """

    geometry: Geometry
    parameter: str
    harmonic: int | None = None

    def rim(self, phi: np.ndarray, order: int = 0) -> np.ndarray:
        """Velocity of the physical rim point, or its derivative by phi (`order` <= 1)."""
        g, k = self.geometry, self.harmonic
        if self.parameter in ("shape_cos", "shape_sin"):
            assert k is not None
            shift = 0.0 if self.parameter == "shape_cos" else -np.pi / 2
            wave = [np.cos(k * phi + shift), -k * np.sin(k * phi + shift)]
            return g.stretch(g.moved(phi, wave[: order + 1]))
        if self.parameter == "stretch_x":
            return np.real(g.rim(phi, order)) / g.stretch_x + 0j
        if self.parameter == "stretch_y":
            return 1j * np.imag(g.rim(phi, order)) / g.stretch_y
        return np.zeros(phi.shape, complex)

    def unfolding(self, z: np.ndarray) -> np.ndarray:
        """Velocity of the unfolded place of the physical place z."""
        g = self.geometry
        if self.parameter == "anisotropy_ratio":
            squeeze = g.anisotropy_ratio**-0.25
            slope = -0.25 * squeeze / g.anisotropy_ratio
            turn = np.exp(1j * np.radians(g.anisotropy_deg))
            return turn * _axis_stretch(z / turn, slope, -slope / squeeze**2)
        if self.parameter == "anisotropy_deg":
            unturned = g.unfold(1j * z)
            return np.radians(1.0) * (1j * g.unfold(z) - unturned)
        return np.zeros(np.shape(z), complex)


def even_angles(n_electrodes: int, first_deg: float = 0.0) -> np.ndarray:
    """(n,) degrees: electrodes evenly round the rim, counter-clockwise from the first."""
    return first_deg + 360.0 * np.arange(n_electrodes) / n_electrodes
