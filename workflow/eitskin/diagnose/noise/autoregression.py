"""Noise that is correlated from frame to frame, as an autoregressive process of order 1."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Autoregression:
    """The filter that whitens AR(1) noise of unit variance, channel by channel over the frames that
    have a reading: x_n -> (x_n - a_n x_p(n)) / sqrt(1 - a_n^2), a_n = correlation^(frames between).

    previous (N, M): row p(n) of the channel's reading before. coefficient (N, M): a_n, 0 for a
    channel's first reading. scale (N, M): 1 / sqrt(1 - a_n^2).
    """

    previous: np.ndarray
    coefficient: np.ndarray
    scale: np.ndarray

    @classmethod
    def from_mask(
        cls, mask: np.ndarray, frame_number: np.ndarray, correlation: float
    ) -> "Autoregression":
        """Of readings where a mask (N, M) is True, in frames of ascending numbers (N,)."""
        rows = np.arange(len(mask))[:, None]
        latest = np.maximum.accumulate(np.where(mask, rows, -1), axis=0)
        previous = np.vstack([np.full((1, mask.shape[1]), -1), latest[:-1]])
        correlated = mask & (previous >= 0)
        previous = np.maximum(previous, 0)
        gap = np.where(correlated, frame_number[:, None] - frame_number[previous], 1.0)
        coefficient = np.where(correlated, correlation**gap, 0.0)
        return cls(previous, coefficient, 1.0 / np.sqrt(1.0 - coefficient**2))

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """(..., N, M): values, filtered."""
        index = self.previous * values.shape[-1] + np.arange(values.shape[-1])
        flat = values.reshape(*values.shape[:-2], self.previous.size)
        previous_values = flat.take(index, axis=-1, mode="clip")
        return (values - self.coefficient * previous_values) * self.scale

    def whiten_transposed(self, values: np.ndarray) -> np.ndarray:
        """(..., N, M): the transpose of the filter, applied to values."""
        values = values * self.scale
        rows, channels = np.nonzero(self.coefficient)
        share = self.coefficient[rows, channels] * values[..., rows, channels]
        values[..., self.previous[rows, channels], channels] -= share
        return values

    def unwhiten(self, whitened: np.ndarray) -> np.ndarray:
        """(..., N, M): the inverse of the filter."""
        values = whitened / self.scale
        channel = np.arange(values.shape[-1])
        for row in range(1, values.shape[-2]):
            carried = self.coefficient[row] * values[..., self.previous[row], channel]
            values[..., row, :] += carried
        return values

    @property
    def log_determinant(self) -> float:
        """Of the process' covariance."""
        return -2.0 * float(np.log(self.scale).sum())

    @property
    def single_precision(self) -> "Autoregression":
        """The same in single precision."""
        coefficient, scale = (a.astype(np.float32) for a in (self.coefficient, self.scale))
        return replace(self, coefficient=coefficient, scale=scale)


def pulse_norm(frame_number: np.ndarray, correlation: float) -> np.ndarray:
    """(N,): length of what the filter makes of one in a single frame and 0 elsewhere, in an endless
    row of frames; frame_number (N,), ascending."""
    steps = np.concatenate([[1.0], np.diff(frame_number), [1.0]])
    square = correlation ** (2.0 * steps)
    return np.sqrt(1.0 / (1.0 - square[:-1]) + square[1:] / (1.0 - square[1:]))
