"""Residuals in units of their noise: white noise, numerical error, shared baselines, rig errors.

The covariance is built from within: noise of each channel, of some spectrum (`lasting_filter`);
then, of low rank in what is already whitened (`low_rank`), the errors of frames, of presses, of
channels and of the whole recording. Frames come before channels: displaced touches weigh most, and
nothing of them must be left. Errors of different kinds are taken out one after the other, which is
exact for kinds that share no direction; a channel's error that is large and the same for long is
carried to other channels by what frames and presses take out: `linked` errors are followed there.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from eitskin import cores
from eitskin.diagnose.noise.lasting_filter import LastingFilter, pulse_norm
from eitskin.diagnose.noise.low_rank import (
    BATCH_COLUMNS,
    LinkedFactor,
    LowRankFactor,
    ProjectionFactor,
    in_batches,
)
from eitskin.diagnose.noise.spectrum import WHITE, Spectrum

# Error of a simulation that is the same in every frame, of the median |v|: what two exact solvers
# of one model differ by.
SOLVER_ERROR = 1e-5
ORDER = ("frame", "press", "linked", "channel", "whole")  # in which errors are taken out
# Single precision is used from so many frames and channels on, while the eigenvalues of every error
# are below MOST_IN_SINGLE, and those of linked ones below MOST_LINKED_IN_SINGLE, at which what
# remains of a channel is exact to 2e-3.
LEAST_IN_SINGLE, MOST_IN_SINGLE, MOST_LINKED_IN_SINGLE = 30, 1e7, 1e5


@dataclass(frozen=True)
class ErrorColumns:
    """Errors of a rig as columns in the recording's unit that stand for one sd each.

    channel (R, N, M): of every channel, independent from channel to channel; frame (K, N, M): of
    every frame, independent from frame to frame; whole (Q, N, M): of all readings together; press
    (P, N, M): of every press, independent from press to press, where press_label (N,) is the press
    of each frame, -1 for none; linked (L, N, M): as those of a channel, followed into other
    channels. filtered: columns are those of `Whitening.filtered` already.
    """

    channel: np.ndarray
    frame: np.ndarray
    whole: np.ndarray
    press: np.ndarray | None = None
    press_label: np.ndarray | None = None
    linked: np.ndarray | None = None
    filtered: bool = False

    def by_kind(self, kind: str) -> np.ndarray:
        """(K, N, M): the columns of one kind of ORDER."""
        columns = getattr(self, kind)
        return self.channel[:0] if columns is None else columns


@dataclass(frozen=True)
class Whitening:
    """Square root of the inverse covariance of readings (N, M), applied by a call.

    mask (N, M): True where there is a reading. sd (M,): of each channel's noise. offset_ratio (M,):
    variance of an error of each channel that is the same in all frames, over that of its noise;
    infinite where values are differences from one baseline, whose constant is free. spectrum: of
    the noise, over frames of ascending frame_number (N,), or else in a row; wander: of what is
    slower and no part of this covariance, unless `errors` have it. errors: of the rig. Those of a
    frame count as independent from frame to frame in what is whitened in time already; those of a
    channel as they are in what frames and presses have left.
    """

    mask: np.ndarray
    sd: np.ndarray
    offset_ratio: np.ndarray
    spectrum: Spectrum = WHITE
    wander: Spectrum = WHITE
    errors: ErrorColumns | None = field(default=None, repr=False)
    frame_number: np.ndarray | None = field(default=None, repr=False)

    @classmethod
    def from_readings(
        cls, voltage: np.ndarray, sd: np.ndarray, difference: bool, offset_sd: np.ndarray
    ) -> "Whitening":
        """For readings (N, M), NaN where lost, noise sd (M,) and the sd (M,) of an error that is
        the same in all frames."""
        ratio = np.full(sd.shape, np.inf) if difference else (offset_sd / sd) ** 2
        return cls(np.isfinite(voltage), sd, ratio)

    @property
    def size(self) -> int:
        """Number of readings, less those that a free constant takes."""
        free = np.isinf(self.offset_ratio) & self.mask.any(axis=0)
        return int(self.mask.sum() - free.sum())

    def with_errors(self, errors: ErrorColumns) -> "Whitening":
        """The same noise with errors of a rig; the filter of the noise is not computed again."""
        whitening = replace(self, errors=errors)
        if self.spectrum:
            vars(whitening)["_lasting_filter"] = self._lasting_filter
        return whitening

    @property
    def by_channel(self) -> bool:
        """Whether what is whitened stays within its channel."""
        if self.errors is None:
            return True
        return not any(len(self.errors.by_kind(kind)) for kind in ("frame", "whole", "press"))

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """(..., N, M) whitened, 0 where lost."""
        factors = self.factors

        def whitened(batch: np.ndarray) -> np.ndarray:
            white = self._filtered(batch)
            for factor in factors:
                white = factor.apply(white, factor.inverse_root)
            return np.where(self.mask, white, 0.0)

        return in_batches(whitened, values, cores.threaded)

    def transposed(self, whitened: np.ndarray) -> np.ndarray:
        """(..., N, M): the transpose of whitening, applied; of whitened values it is the inverse
        covariance times the values."""
        values = whitened
        for factor in reversed(self.factors):
            values = factor.apply(values, factor.inverse_root)
        values = np.where(self.mask, values, 0.0)
        if self.spectrum:
            values = self._lasting_filter.whiten_transposed(values)
        return np.where(self.mask, values, 0.0) / self.sd

    def unwhitened(self, whitened: np.ndarray) -> np.ndarray:
        """(..., N, M): values as before whitening, 0 where lost; a free constant stays taken
        out."""
        values = whitened
        for factor in reversed(self.factors):
            values = factor.apply(values, factor.root)
        if self.spectrum:
            values = self._lasting_filter.unwhiten(values)
        return np.where(self.mask, values, 0.0) * self.sd

    def channel_lengths(self, column: np.ndarray, channels: np.ndarray) -> np.ndarray:
        """(C,): squared length, whitened, of the part of a column (N, M) in each of C channels
        alone."""
        if self.by_channel:
            return (self(column) ** 2).sum(axis=0)[channels].astype(float)

        def lengths(start: int) -> np.ndarray:
            batch = channels[start : start + BATCH_COLUMNS]
            separate = np.zeros((len(batch), *column.shape), column.dtype)
            separate[np.arange(len(batch)), :, batch] = column[:, batch].T
            return (self(separate) ** 2).sum(axis=(1, 2)).astype(float)

        batches = cores.threaded(lengths, range(0, len(channels), BATCH_COLUMNS))
        return np.concatenate([np.zeros(0), *batches])

    def filtered(self, columns: np.ndarray, acts_on: str) -> np.ndarray:
        """(K, N, M): columns of errors in units of the noise, as the filter in time leaves them."""
        if acts_on == "frame":
            return np.where(self.mask, columns, 0.0) / self.sd * self._pulse_norm[:, None]
        return self._filtered(columns)

    def entered(self, columns: np.ndarray, acts_on: str) -> np.ndarray:
        """(K, N, M): `filtered` columns as they are where the errors of their kind are taken out:
        those of presses after those of frames."""
        return self._entered(columns, acts_on, self.factors)

    @staticmethod
    def _entered(columns: np.ndarray, acts_on: str, factors: list[LowRankFactor]) -> np.ndarray:
        for factor in factors:
            if acts_on == "press" and factor.acts_on == "frame":
                columns = factor.apply(columns, factor.inverse_root)
        return columns

    def conjugate(self, whitened: np.ndarray, acts_on: str) -> np.ndarray:
        """(..., N, M): of whitened values, that whose product with `entered` columns is the product
        of the columns with the inverse covariance times the values."""
        for factor in reversed(self.factors[self._free_constants :]):
            if ORDER.index(factor.acts_on) >= ORDER.index(acts_on):
                whitened = factor.apply(whitened, factor.inverse_root)
        return whitened

    @cached_property
    def log_determinant(self) -> float:
        """Of the covariance over that of the noise's variances alone; free constants aside."""
        total = sum(factor.log_determinant for factor in self.factors[self._free_constants :])
        return total + self._lasting_filter.log_determinant if self.spectrum else total

    @property
    def _free_constants(self) -> int:
        """How many of the factors take out free constants: 0 or 1."""
        return int(np.isinf(self.offset_ratio).any())

    @cached_property
    def numbers(self) -> np.ndarray:
        """(N,): the numbers of the frames."""
        if self.frame_number is None:
            return np.arange(float(len(self.mask)))
        return self.frame_number.astype(float)

    @cached_property
    def _pulse_norm(self) -> np.ndarray:
        """(N,): `pulse_norm` of these frames."""
        return pulse_norm(self.numbers, self.spectrum)

    @cached_property
    def _lasting_filter(self) -> LastingFilter:
        """The filter of the noise in time."""
        return LastingFilter.from_mask(self.mask, self.numbers, self.spectrum)

    def _filtered(self, values: np.ndarray) -> np.ndarray:
        """(..., N, M): values in units of the noise, 0 where lost, filtered in time."""
        scaled = np.where(self.mask, values, 0.0) / self.sd
        return self._lasting_filter.whiten(scaled) if self.spectrum else scaled

    def __getstate__(self) -> dict:
        """Without `factors`: to compute them takes less than to copy them."""
        return {name: value for name, value in vars(self).items() if name != "factors"}

    def forget(self) -> None:
        """Frees the memory of `factors`, which are computed anew where they are needed."""
        vars(self).pop("factors", None)

    @property
    def single_precision(self) -> "Whitening":
        """The same in single precision; itself where that would be too inexact."""

        def is_large(factor: LowRankFactor) -> bool:
            limit = MOST_LINKED_IN_SINGLE if factor.acts_on == "linked" else MOST_IN_SINGLE
            return bool(factor.eigenvalues.max(initial=0.0) > limit)

        if min(self.mask.shape) < LEAST_IN_SINGLE or any(map(is_large, self.factors)):
            return self
        single = replace(self, sd=self.sd.astype(np.float32))
        vars(single)["factors"] = factors = [factor.single_precision for factor in self.factors]
        for number, factor in enumerate(factors):
            if isinstance(factor, LinkedFactor):
                factor.carriers = factors[:number]
        if self.spectrum:
            vars(single)["_lasting_filter"] = self._lasting_filter.single_precision
        return single

    @cached_property
    def factors(self) -> list[LowRankFactor]:
        """Factors of low rank, in the order in which they are applied, free constants first."""
        free = np.isinf(self.offset_ratio)
        offset = np.where(free, 1.0, np.sqrt(self.offset_ratio)) * self.sd
        offset = self._filtered(np.broadcast_to(offset, (1, *self.mask.shape)))
        empty = np.zeros((0, *self.mask.shape))
        columns = dict.fromkeys(ORDER, empty)
        if self.errors is not None:
            columns = {kind: self.errors.by_kind(kind) for kind in ORDER}
            if not self.errors.filtered:
                columns = {kind: self.filtered(vectors, kind) for kind, vectors in columns.items()}
        factors: list[LowRankFactor] = []
        if self._free_constants:
            factors.append(ProjectionFactor(offset, "channel"))
        else:
            columns["channel"] = np.concatenate([offset, columns["channel"]])
        for kind in ORDER:
            if len(columns[kind]):
                factors.append(self._factor(columns[kind], kind, factors))
        return factors

    def _factor(
        self, columns: np.ndarray, kind: str, earlier: list[LowRankFactor]
    ) -> LowRankFactor:
        """The factor of filtered columns of one kind, after earlier ones."""
        columns = self._entered(columns, kind, earlier)
        if kind == "linked":
            return LinkedFactor(columns, earlier[self._free_constants :])
        if kind == "whole":
            for factor in earlier:
                columns = factor.apply(columns, factor.inverse_root)
        label = self.errors.press_label if self.errors is not None and kind == "press" else None
        return LowRankFactor(columns, kind, label)
