"""The filter that whitens noise which lasts from frame to frame (Kalman 1960)."""

from dataclasses import dataclass, replace

import numpy as np

from eitskin.diagnose.noise.spectrum import Spectrum


@dataclass(frozen=True)
class LastingFilter:
    """Innovations of noise of unit variance and some spectrum, channel by channel over the frames
    that have a reading: x_n less what the readings before predict of it, over its sd.

    gain (J, N, M): of each process' state, by the reading's innovation, 0 where a reading is lost;
    decay (J, N, 1): of the states to the next frame; scale (N, M): 1 over the sd of innovations, 0
    where a reading is lost.
    """

    gain: np.ndarray
    decay: np.ndarray
    scale: np.ndarray

    @classmethod
    def from_mask(
        cls, mask: np.ndarray, frame_number: np.ndarray, spectrum: Spectrum
    ) -> "LastingFilter":
        """Of readings where a mask (N, M) is True, in frames of ascending numbers (N,)."""
        shares, correlations = np.array(spectrum.shares), np.array(spectrum.correlations)
        steps = np.append(np.diff(frame_number.astype(float)), 1.0)
        decay = correlations[:, None] ** steps
        columns, inverse = np.unique(mask, axis=1, return_inverse=True)
        process = np.diag(shares)
        covariance = np.repeat(process[..., None], columns.shape[1], axis=2)  # of predicted states
        gain = np.zeros((len(shares), *columns.shape))
        scale = np.zeros(columns.shape)
        for n, is_read in enumerate(columns):
            with_sum = covariance.sum(axis=1)
            variance = with_sum.sum(axis=0) + spectrum.white_share
            gain[:, n] = np.where(is_read, with_sum / variance, 0.0)
            scale[n] = np.where(is_read, 1.0 / np.sqrt(variance), 0.0)
            covariance = covariance - gain[:, n][:, None] * with_sum[None]
            step = decay[:, n]
            covariance = np.outer(step, step)[..., None] * (covariance - process[..., None])
            covariance += process[..., None]
        inverse = inverse.ravel()
        return cls(gain[:, :, inverse], decay[..., None], scale[:, inverse])

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """(..., N, M): values, filtered."""
        rows = np.moveaxis(values, -2, 0)
        white = np.empty_like(rows, dtype=np.result_type(values, self.scale))
        state = np.zeros((len(self.gain), *rows.shape[1:]), white.dtype)
        for n, row in enumerate(rows):
            innovation = row - state.sum(axis=0)
            white[n] = innovation * self.scale[n]
            self._advance(state, innovation, n)
        return np.ascontiguousarray(np.moveaxis(white, 0, -2))

    def unwhiten(self, whitened: np.ndarray) -> np.ndarray:
        """(..., N, M): the inverse of the filter; where a reading is lost, what the ones before
        predict of it."""
        rows = np.moveaxis(whitened, -2, 0)
        values = np.empty_like(rows)
        state = np.zeros((len(self.gain), *rows.shape[1:]), rows.dtype)
        for n, row in enumerate(rows):
            scale = self.scale[n]
            innovation = np.divide(row, scale, out=np.zeros_like(row), where=scale > 0.0)
            values[n] = innovation + state.sum(axis=0)
            self._advance(state, innovation, n)
        return np.ascontiguousarray(np.moveaxis(values, 0, -2))

    def whiten_transposed(self, values: np.ndarray) -> np.ndarray:
        """(..., N, M): the transpose of the filter, applied to values."""
        rows = np.moveaxis(values, -2, 0)
        result = np.empty_like(rows)
        state = np.zeros((len(self.gain), *rows.shape[1:]), rows.dtype)
        for n in range(len(rows) - 1, -1, -1):
            state *= self._extended(self.decay[:, n], state)
            innovation = self.scale[n] * rows[n]
            innovation += (self._extended(self.gain[:, n], state) * state).sum(axis=0)
            result[n] = innovation
            state -= innovation
        return np.ascontiguousarray(np.moveaxis(result, 0, -2))

    def _advance(self, state: np.ndarray, innovation: np.ndarray, n: int) -> None:
        """Predicted states (J, ..., M) of frame n + 1, in place of those of frame n."""
        state += self._extended(self.gain[:, n], state) * innovation
        state *= self._extended(self.decay[:, n], state)

    @staticmethod
    def _extended(factor: np.ndarray, state: np.ndarray) -> np.ndarray:
        """A factor (J, M) or (J, 1) with the axes of states (J, ..., M)."""
        return factor.reshape(len(factor), *[1] * (state.ndim - 2), factor.shape[-1])

    @property
    def log_determinant(self) -> float:
        """Of the noise's covariance over its unit variances."""
        return -2.0 * float(np.log(self.scale[self.scale > 0.0]).sum())

    @property
    def single_precision(self) -> "LastingFilter":
        """The same in single precision."""
        arrays = {name: value.astype(np.float32) for name, value in vars(self).items()}
        return replace(self, **arrays)


def pulse_norm(frame_number: np.ndarray, spectrum: Spectrum) -> np.ndarray:
    """(N,): length of what the filter makes of one in a single frame and 0 elsewhere, of frames of
    ascending numbers (N,): the root of the precision's diagonal."""
    return np.sqrt(np.diag(np.linalg.inv(spectrum.covariance(frame_number))))
