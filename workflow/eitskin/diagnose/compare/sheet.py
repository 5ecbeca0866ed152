"""The simulation that objects are sought with: an even sheet of radius 1 with point electrodes."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from eitskin.diagnose.compare.discs import REACH, STRONG_LOG_RATIO, Disc
from eitskin.physics.forward import Accuracy, Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.touch import Touch, TouchAccuracy

# A thousandth of a change: a sheet in place of a tank is wrong by more.
ACCURACY = Accuracy(1, TouchAccuracy(8, 1e-3, 6, 1e-2), 1)
LEAST_CORRELATION = 0.8  # squared, of the control's readings with the sheet's, to simulate it
FAINT = 0.05  # of the median simulated reading, below which a share of it means nothing
RINGS = ((0.0, 1), (0.3, 8), (0.5, 12), (0.65, 16), (0.78, 24), (0.88, 32))  # radius and discs
RADII = (0.08, 0.18)  # of the grid's discs, from which fits start
LOG_RATIOS = (-STRONG_LOG_RATIO, -0.8, 0.8, STRONG_LOG_RATIO)  # strong, and about twice
RISE = 0.02  # of the conductivity across the skin, for its tangent: small, above the accuracy


class Sheet:
    """Readings of an even sheet, and what discs change of them.

    channels (M, 4); electrode_deg (n,); signed: whether readings are, else their sizes are taken.
    simulated (M,) bool: all but channels of driven electrodes, whose readings are 0 here.
    """

    def __init__(self, channels: np.ndarray, electrode_deg: np.ndarray, signed: bool):
        self.channels, self.signed = channels, signed
        angle = np.asarray(electrode_deg, float)
        self.forward = Forward(
            Geometry(1.0, 1.0, 1.0, angle, np.array(0.0), np.array(0.0)), ACCURACY
        )
        values = channel_values(self.forward.transfer_impedance(), channels)
        self.simulated = np.isfinite(values)
        self.signed_readings = np.where(self.simulated, values, 0.0)
        self.readings = self.signed_readings if signed else np.abs(self.signed_readings)

    def resembles(self, mean: np.ndarray, read: np.ndarray) -> bool:
        """Whether mean readings (M,), V, of channels read (M,) bool are such a sheet's, up to a
        factor."""
        mask = read & self.simulated
        a, b = mean[mask], self.readings[mask]
        squares = float(a @ a) * float(b @ b)
        return squares > 0 and float(a @ b) > 0 and (a @ b) ** 2 > LEAST_CORRELATION * squares

    def gain(self, mean: np.ndarray, read: np.ndarray, offset: bool) -> np.ndarray:
        """The factors (M,), V, that turn a simulated change into a measured one.

        offset: whether a common voltage is subtracted from the mean readings (M,) before.
        """
        mask = read & self.simulated
        columns = np.column_stack([self.readings, np.ones(len(mean))])[:, : 1 + offset]
        scale, *offsets = np.linalg.lstsq(columns[mask], mean[mask], rcond=None)[0]
        mean = mean - sum(offsets)
        faint = FAINT * float(np.median(np.abs(self.readings[mask])))
        deviation = self.readings * (mean - scale * self.readings) / (self.readings**2 + faint**2)
        return np.where(mask, scale + deviation, 0.0)

    def change(self, discs: Sequence[Disc]) -> np.ndarray:
        """The change (M,) by discs, per unit of gain. Raises InputError where discs overlap."""
        impedance = self.forward.transfer_impedance(_touches(discs))
        return self._change(channel_values(impedance, self.channels))

    def _change(self, values: np.ndarray) -> np.ndarray:
        values = np.where(self.simulated, values, 0.0)
        return (values if self.signed else np.abs(values)) - self.readings

    def derivatives(self, discs: Sequence[Disc]) -> np.ndarray:
        """Derivatives (M, 4 k) of `change` by x, y, radius and ratio of each disc."""
        names = [
            f"{key}[{i}]"
            for i in range(len(discs))
            for key in ("x_mm", "y_mm", "radius_mm", "contrast")
        ]
        touches = _touches(discs)
        impedances = self.forward.derivatives(touches, names)
        columns = np.column_stack(
            [channel_values(impedances[name], self.channels) for name in names]
        )
        columns[~self.simulated] = 0.0
        if not self.signed:
            values = channel_values(self.forward.transfer_impedance(touches), self.channels)
            columns *= np.where(values < 0, -1.0, 1.0)[:, None]
        return columns

    @cached_property
    def tangents(self) -> dict[str, np.ndarray]:
        """Changes (M, k) per unit, by name: of a shift of each electrode, and of a rise of the
        conductivity along x and y."""
        names = [f"electrode_deg[{i}]" for i in range(self.forward.electrodes.n)]
        shifts = self.forward.derivatives(parameters=names)
        geometry = self.forward.geometry
        tilted = [
            Forward(geometry.with_values(gradient_across=RISE, gradient_deg=angle), ACCURACY)
            for angle in (0.0, 90.0)
        ]
        rises = [f.transfer_impedance() - self.forward.transfer_impedance() for f in tilted]
        impedances = {"electrode-position": [shifts[name] for name in names]}
        impedances["conductivity-gradient"] = [rise / RISE for rise in rises]
        positive = self.signed | (self.signed_readings >= 0)
        sign = np.where(self.simulated & positive, 1.0, -1.0 * self.simulated)
        return {
            name: np.column_stack(
                [
                    np.where(self.simulated, channel_values(z, self.channels), 0.0) * sign
                    for z in changes
                ]
            )
            for name, changes in impedances.items()
        }

    @cached_property
    def grid(self) -> tuple[list[Disc], np.ndarray]:
        """Discs all over the skin, and the change (M, N) by each."""
        discs, columns = [], []
        ratios = np.exp(LOG_RATIOS)
        for share, count in RINGS:
            for k in range(count):
                centre = share * np.exp(2j * np.pi * k / count)
                for radius in RADII:
                    if share + radius >= REACH:
                        continue
                    place = self.forward.place(centre.real, centre.imag, radius)
                    impedances = place.impedance_change(ratios - 1.0)
                    impedances = impedances + self.forward.transfer_impedance()
                    columns += [self._change(channel_values(z, self.channels)) for z in impedances]
                    discs += [Disc(centre.real, centre.imag, radius, r) for r in ratios.tolist()]
        return discs, np.column_stack(columns)


def _touches(discs: Sequence[Disc]) -> list[Touch]:
    return [Touch(d.x, d.y, d.radius, d.ratio - 1.0) for d in discs]
