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
    known place and force. press (N,): the press that such a frame is of, -1 for no press. force_N
    (N,): of every frame's touch. elapsed (N,): share of the recording's time that has gone.
    difference, magnitude: whether readings are differences from a baseline, or magnitudes.
    typical_reading: median |v| of the recording, or its noise where that is larger. converter_step:
    width of a converter's step that is wider than the noise, else 0. number (N,): of the frames.
    noise_sd (M,): of the channels. wander: of each channel's noise, what is slow. families
    (K, N, M): by name what a typical change of each of K members does to the readings.
    """

    voltage: np.ndarray
    derivatives: Mapping[str, np.ndarray]
    touched: np.ndarray
    press: np.ndarray
    force_N: np.ndarray
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
