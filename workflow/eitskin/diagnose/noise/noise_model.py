"""The noise of a recording, as the diagnosis uses it."""

from dataclasses import dataclass, replace

import numpy as np

from eitskin.diagnose.noise.spectrum import WHITE, Spectrum

NORMAL_90 = 1.6449  # sd of a normal distribution, within which 90 % of it are


@dataclass(frozen=True)
class VarianceLaw:
    """Sd of readings by their untouched level v: sqrt(constant + growth v^2), at least `floor`."""

    constant: float
    growth: float
    floor: float = 0.0

    def __call__(self, level: np.ndarray) -> np.ndarray:
        """(M,) sd of channels of these levels (M,)."""
        return np.maximum(np.sqrt(self.constant + self.growth * level**2), self.floor)


@dataclass(frozen=True)
class NoiseModel:
    """Noise of M channels, in the recording's unit.

    sd (M,): of each channel, of the whole spectrum. dof: degrees of freedom of the
    overall scale (squared). source: where the sd comes from, for a reader. rounding_sd: of the
    error that rounding makes alike in frames that are alike, the same in all channels;
    converter_step: width of the steps that do so, else 0. spectrum: of each channel's noise over
    the frames' numbers; wander: processes that are slower, as they were estimated, none of them in
    `sd`. drift: sd at the recording's end, in units of `sd`, of
    an independent random walk of each channel in time. rejected_mask (N, M): readings rejected as
    spikes, spike_count of them, or in loud_frames (rows); None: none. law: by which the sd was
    estimated.
    """

    sd: np.ndarray
    dof: float
    source: str
    rounding_sd: float = 0.0
    converter_step: float = 0.0
    spectrum: Spectrum = WHITE
    wander: Spectrum = WHITE
    drift: float = 0.0
    rejected_mask: np.ndarray | None = None
    loud_frames: tuple[int, ...] = ()
    spike_count: int = 0
    law: VarianceLaw | None = None

    def with_simulated_level(self, reserved: np.ndarray, level: np.ndarray) -> "NoiseModel":
        """The same noise, in channels of a mask `reserved` (M,) by the law at their simulated
        untouched level (M,): their own readings are not to be used."""
        if self.law is None:
            return self
        return replace(self, sd=np.where(reserved, self.law(level), self.sd))

    @property
    def white_sd(self) -> np.ndarray:
        """(M,): sd of the white part of each channel's noise; of all of it, where it has none."""
        share = self.spectrum.white_share
        return self.sd * np.sqrt(share) if share > 0.0 else self.sd

    def correlation_sd(self, correlation: float) -> float:
        """Standard error of a correlation estimated from `dof` values (Bartlett 1946)."""
        return float(np.sqrt((1.0 - correlation**2) / self.dof))
