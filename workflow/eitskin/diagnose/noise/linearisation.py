"""What the errors of a rig need of a fit: its readings and their derivatives by the touches."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from eitskin.diagnose.noise.spectrum import Spectrum


@dataclass(frozen=True)
class Linearisation:
    """Simulated readings of N frames and M channels, about which errors count as proportional.

    voltage (N, M): readings of a fit, in the recording's unit. derivatives: of these (N, M) by the
    place and the force of each frame's touch, by column of the states (x_mm, y_mm, force_N); a
    column by which the physics has no derivative is missing. touched (N,): frames with a touch of
    known place and force. press (N,): the press that such a frame is of, -1 for no press. states:
    place and force (N,) of every frame's touch, by those columns. time_s (N,), and whether it was
    measured: timed. elapsed (N,): share of the recording's time that has gone. difference,
    magnitude: whether readings are differences from a baseline, or magnitudes.
    typical_reading: median |v| of the recording, or its noise where that is larger. converter_step:
    width of a converter's step that is wider than the noise, else 0. number (N,): of the frames.
    noise_sd (M,): of the channels. wander: of each channel's noise, what is slow. families
    (K, N, M): by name what a typical change of each of K members does to the readings.
    """

    voltage: np.ndarray
    derivatives: Mapping[str, np.ndarray]
    touched: np.ndarray
    press: np.ndarray
    states: Mapping[str, np.ndarray]
    time_s: np.ndarray
    timed: bool
    elapsed: np.ndarray
    difference: bool
    magnitude: bool
    typical_reading: float
    converter_step: float
    number: np.ndarray
    noise_sd: np.ndarray
    wander: Spectrum
    families: Mapping[str, np.ndarray] = field(default_factory=dict)

    @cached_property
    def untouched_level(self) -> np.ndarray:
        """(M,): mean reading of the untouched frames, of all where every frame is touched; 0 for
        differences, whose level is arbitrary."""
        if self.difference:
            return np.zeros(self.voltage.shape[1])
        untouched = self.voltage if self.touched.all() else self.voltage[~self.touched]
        return untouched.mean(axis=0)

    @property
    def press_count(self) -> int:
        """Number of presses that some frame is of."""
        return len(np.unique(self.press[self.press >= 0]))

    @property
    def force_N(self) -> np.ndarray:
        """(N,): of every frame's touch."""
        return self.states["force_N"]

    @cached_property
    def _press_rows(self) -> list[np.ndarray]:
        """Rows of each press of two frames or more, in their order."""
        numbers = np.unique(self.press[self.press >= 0])
        rows = [np.flatnonzero(self.press == number) for number in numbers]
        return [row for row in rows if len(row) > 1]

    @cached_property
    def press_share(self) -> np.ndarray:
        """(N,): share of a press's frames that have gone; 0 where no press is."""
        shares = np.zeros(len(self.press))
        for rows in self._press_rows:
            shares[rows] = np.linspace(0.0, 1.0, len(rows))
        return shares

    @cached_property
    def rate(self) -> dict[str, np.ndarray]:
        """(N,): change a second of each column of the states within presses, by central
        differences; 0 where no press is."""
        rates = {column: np.zeros(len(self.press)) for column in self.states}
        for rows in self._press_rows:
            time_s = self.time_s[rows]
            if (np.diff(time_s) > 0.0).all():
                for column, values in self.states.items():
                    rates[column][rows] = np.gradient(values[rows], time_s)
        return rates

    @cached_property
    def slide_mm(self) -> float:
        """The largest distance between the mean places of a press's halves; 0 without presses."""
        places = np.array([self.states["x_mm"], self.states["y_mm"]])
        halves = [np.array_split(rows, 2) for rows in self._press_rows]
        ways = [
            np.linalg.norm(places[:, late].mean(axis=1) - places[:, early].mean(axis=1))
            for early, late in halves
        ]
        return float(max(ways, default=0.0))
