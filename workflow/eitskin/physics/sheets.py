"""Several sheets at once, each with a rim and electrodes of its own, on NumPy or on a device of
PyTorch: for sets of touches over many new skins.

The formulas are Forward's; what is smooth runs over all skins and touches together. Touches whose
edges are graded towards the rim are found one by one, by Forward.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from eitskin.errors import InputError
from eitskin.physics.arrays import NUMPY, as_in, library
from eitskin.physics.conformal import DiscMaps
from eitskin.physics.depth import span
from eitskin.physics.electrodes import Electrodes, contact_drop, interaction, tested
from eitskin.physics.even_touches import EvenTouches, by_resolution, touches_per_batch
from eitskin.physics.forward import (
    ACCURACIES,
    Accuracy,
    Forward,
    TouchModes,
    channel_values,
    disc_map,
    separated_modes,
)
from eitskin.physics.geometry import Geometry, Unfoldings
from eitskin.physics.harmonics import symmetric
from eitskin.physics.touch import EDGE_ANGLES, Circle

CORE_BYTES, DEVICE_BYTES = 1 << 22, 1 << 30  # of an array of touches that are found together
INSIDE_MM = 1.0  # radius of a touch in the middle, which stands for one that Forward finds


class Sheets:
    """Sheets of as many electrodes each, ready to be touched.

    device: None for NumPy; else a device of PyTorch, as "cpu" or "cuda", on which results lie, too.
    Raises InputError for a body, an outline, electrodes inside, a patch, a gradient, point
    electrodes, and numbers of electrodes that differ.
    """

    def __init__(
        self,
        geometries: Sequence[Geometry],
        accuracy: str | Accuracy = "train",
        device: str | None = None,
    ):
        _check(geometries)
        self.geometries = geometries
        self.accuracy = ACCURACIES[accuracy] if isinstance(accuracy, str) else accuracy
        self._array: Any = NUMPY if device is None else _device_array(device)
        nbytes = CORE_BYTES if device in (None, "cpu") else DEVICE_BYTES
        self._most_bytes = nbytes // len(geometries)
        discs = [disc_map(geometry) for geometry in geometries]
        order = max(self.accuracy.modes(geometry) for geometry in geometries)
        electrodes = list(map(Electrodes, geometries, discs, [order] * len(discs)))
        self.maps = DiscMaps(discs, self._array)
        self.unfoldings = Unfoldings(geometries, self._array)
        self.n, self.order = electrodes[0].n, order
        self.modes = self._stacked([electrodes[0].modes])[0]
        theta, stretch, factor, arc = (
            self._stacked([getattr(skin_electrodes, name) for skin_electrodes in electrodes])
            for name in ("theta", "stretch", "factor", "arc_m")
        )
        self.rim = library(theta).exp(1j * theta.reshape(len(electrodes), -1))
        self.sheet_resistance = self._stacked([g.sheet_resistance_ohm for g in geometries])
        length = [1e-3 * g.contact_length_mm for g in geometries]
        t, weight = self._stacked([electrodes[0].t])[0], self._stacked([electrodes[0].weight])[0]
        matrix = interaction(t, self.modes, theta, stretch, factor)
        drop = contact_drop(self.modes, weight, self._stacked(length), arc)
        self._relax(matrix, drop)

    def _stacked(self, values: Any) -> Any:
        return as_in(np.array(values, float), self._array)

    def _relax(self, matrix: Any, drop: Any) -> None:
        """The electrodes' own modes at the least power, as Forward's: the Schur complement."""
        xp, skins = library(matrix), len(self.geometries)
        mode = np.arange(self.n * self.order)
        electrode = xp.arange(self.n, device=matrix.device)
        split = matrix.reshape(skins, self.n, self.order, self.n, self.order)
        split[:, electrode, :, electrode, :] += xp.moveaxis(drop, 1, 0)
        self._whole, self._inner = (
            as_in(mode[is_selected], matrix)
            for is_selected in (mode % self.order == 0, mode % self.order > 0)
        )
        rows = matrix[:, self._inner]
        self._white = xp.linalg.inv(xp.linalg.cholesky(symmetric(rows[:, :, self._inner])))
        coupled = self._white @ rows[:, :, self._whole]
        self._currents = -(coupled.mT @ self._white)
        relative = matrix[:, self._whole][:, :, self._whole]
        self._relative = symmetric(relative - coupled.mT @ coupled)

    def voltages(self, channels: np.ndarray) -> Any:
        """(S, M) V per A, untouched."""
        impedance = self.sheet_resistance[:, None, None] * self._relative
        return channel_values(impedance, as_in(np.array(channels, np.int64), impedance))

    def channel_change(self, places: ArrayLike, channels: np.ndarray, contrast: ArrayLike) -> Any:
        """(S, P, F, M) V per A: change of every channel.

        places (P, 3) or each skin's own (S, P, 3): x_mm, y_mm, radius_mm; contrast (F,). Raises
        InputError as Forward.places, and for places of another shape.
        """
        placed, channels = self._placed(places), np.array(channels, np.int64)
        x, y, radius = (self._stacked(placed[..., k, None]) for k in range(3))
        circles = _Circles(x + 1j * y, radius, self.unfoldings, self.maps)
        even, resolutions = self._resolved(self._gaps(circles))
        circles.move_inside(as_in(~even[..., None], x))
        shape = (*even.shape, np.size(contrast), len(channels))
        change = library(x).empty(shape, dtype=x.dtype, device=x.device)
        for (degree, count), group in self._groups(resolutions):
            modes = self._touched(circles.at_places(as_in(group, x)), degree, count)
            change[:, group] = modes.channel_change(channels, contrast)
        for skin in np.flatnonzero(~even.all(axis=1)).tolist():
            graded_places = np.flatnonzero(~even[skin])
            touches = self._graded(skin, placed[skin, graded_places])
            graded_changes = np.array(
                [modes.channel_change(channels, contrast) for modes in touches]
            )
            change[skin, graded_places] = as_in(graded_changes, x)
        return change

    def _graded(self, skin: int, places: np.ndarray) -> list[TouchModes]:
        """Of touches at places (K, 3) on one skin, on the processor."""
        forward = Forward(self.geometries[skin], self.accuracy)
        return forward.places([(x, y, radius) for x, y, radius in places.tolist()])

    def _placed(self, places: ArrayLike) -> np.ndarray:
        """(S, P, 3). Raises InputError."""
        array, skins = np.asarray(places, float), len(self.geometries)
        if array.ndim < 2 or array.shape[-1] != 3 or array.shape[:-2] not in ((), (skins,)):
            expected = f"(P, 3) or ({skins}, P, 3)"
            raise InputError("touch", "shape of the places", array.shape, expected)
        if not (array[..., 2] > 0).all():
            raise InputError("touch", "radius_mm", array[..., 2].min(), "more than 0")
        return np.broadcast_to(array, (skins, *array.shape[-2:]))

    def _gaps(self, circles: "_Circles") -> np.ndarray:
        """(S, P): as Circle.rim_gaps, as many places at once as others are found."""
        count = circles.radius.shape[1]
        batch = max(self._most_bytes // (16 * len(EDGE_ANGLES)), 1)
        parts = [np.zeros((len(self.geometries), 0))]
        for start in range(0, count, batch):
            selection = slice(start, start + batch)
            parts.append(np.array(circles.at_places(selection).rim_gaps().tolist()))
        return np.concatenate(parts, axis=1)

    def _resolved(self, gaps: np.ndarray) -> tuple[np.ndarray, dict[int, tuple[int, int]]]:
        """Which touches (S, P) are even, and the multipoles and nodes that serve each place on all
        skins."""
        even = np.zeros(gaps.shape, bool)
        finest: dict[int, tuple[int, int]] = {}
        for (degree, count), touches in by_resolution(gaps.ravel(), self.accuracy.touch).items():
            even.ravel()[touches] = True
            for place in np.unique(touches % gaps.shape[1]).tolist():
                coarser = finest.get(place, (0, 0))
                finest[place] = max(degree, coarser[0]), max(count, coarser[1])
        return even, finest

    def _groups(
        self, resolutions: dict[int, tuple[int, int]]
    ) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
        """Places of one resolution, as many as are found together."""
        for resolution in sorted(set(resolutions.values())):
            batch = touches_per_batch(self._most_bytes, *resolution, self.rim.shape[-1])
            group = np.array(
                [
                    place
                    for place, place_resolution in resolutions.items()
                    if place_resolution == resolution
                ]
            )
            for start in range(0, len(group), batch):
                yield resolution, group[start : start + batch]

    def _touched(self, circles: Circle, degree: int, count: int) -> TouchModes:
        """Of touches (S, P) with even nodes."""
        touches = EvenTouches(circles, degree, count)
        coupling = tested(self.modes, touches.rim_response(self.rim[:, None, :]), self.n)
        skins, places, _, columns = coupling.shape
        inner = library(coupling).moveaxis(coupling[:, :, self._inner], 2, 1)
        inner = inner.reshape(skins, -1, places * columns)

        def per_place(values: Any) -> Any:
            split = values.reshape(skins, -1, places, columns)
            return library(values).moveaxis(split, 2, 1)

        gains = coupling[:, :, self._whole] + per_place(self._currents @ inner)
        white = per_place(self._white @ inner)
        turn, poles = separated_modes(touches.mass, touches.self_response - white.mT @ white)
        return TouchModes(self.sheet_resistance[:, None, None, None] ** 0.5 * gains @ turn, poles)


class _Circles(Circle):
    """Circles (S, P, 1) on several skins."""

    def move_inside(self, mask: Any) -> None:
        """Those at a mask (S, P, 1) to where nothing is near them."""
        where = library(self.radius).where
        self.centre = where(mask, 0.0, self.centre)
        self.radius = where(mask, INSIDE_MM, self.radius)

    def at_places(self, places: Any) -> "_Circles":
        """Those at places, indices (K,) or a slice, on every skin."""
        return _Circles(self.centre[:, places], self.radius[:, places], self.geometry, self.disc)

    def select(self, mask: Any) -> Circle:
        """Those at a mask (S, P), as circles (K, 1) each on its skin."""
        skin = mask.nonzero()[0] if library(mask) is np else mask.nonzero(as_tuple=True)[0]
        return Circle(
            self.centre[mask], self.radius[mask], self.geometry.select(skin), self.disc.select(skin)
        )


def _device_array(device: str) -> Any:
    import torch  # here, as NumPy alone needs none

    return torch.zeros(0, dtype=torch.float64, device=device)


def _check(geometries: Sequence[Geometry]) -> None:
    for geometry in geometries:
        for key, value in (
            ("gradient_across", geometry.gradient_across),
            ("patches", len(geometry.patches)),
            ("deep", span(geometry)),
            ("outline", geometry.outline),
            ("electrode_inside_mm", len(geometry.inner)),
        ):
            if value:
                raise InputError("skin", key, value, "none, for several sheets at once")
        if geometry.points:
            raise InputError("skin", "electrode_width_mm", 0, "more than 0, for several at once")
    counts = sorted({len(geometry.electrode_deg) for geometry in geometries})
    if len(counts) != 1:
        raise InputError("skin", "electrodes", counts or "no skin", "as many on each")
