"""Residuals in units of their noise: white noise, numerical error, shared baselines, rig errors.

The covariance is built from within: noise correlated in time, channel by channel (AR(1)); what
each frame has of its own over the channels; what each press has; what each channel has of its own
over the frames; and what all readings have together. Each is of low rank in what is already
whitened, so that its inverse root is cheap (Woodbury 1950). Frames come before channels: touches
that are not where they are said to be weigh most, and nothing of them must be left. A channel's
error that is large and the same for long is carried on to other channels by what frames and presses
take out: `linked` errors are followed there.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from eitskin import cores

# Error of a simulation that is the same in every frame: what is left between two exact solvers of
# one model, of the median |v|.
COHERENT = 1e-5


@dataclass(frozen=True)
class RigErrors:
    """What a rig adds, as columns in the recording's unit that stand for one sd each.

    channel (R, N, M): of every channel, independent from channel to channel; frame (K, N, M): of
    every frame, independent from frame to frame; whole (Q, N, M): of all readings together; press
    (P, N, M): of every press, independent from press to press, which press each frame is of, -1
    none, in `label` (N,); linked (L, N, M): as those of a channel, but followed into the channels
    that what is taken out of frames and presses carries them to. filtered: columns are those of
    `Whitening.filtered` already.
    """

    channel: np.ndarray
    frame: np.ndarray
    whole: np.ndarray
    press: np.ndarray | None = None
    label: np.ndarray | None = None
    linked: np.ndarray | None = None
    filtered: bool = False


TOGETHER = 8  # columns that are whitened at once
ORDER = ("frame", "press", "linked", "channel", "whole")  # in which errors are taken out
TINY = 1e-9  # squared length of a linked error, below which it is none
# Single precision is used from so many frames and channels on, while the squared length of every
# error is below LONGEST_IN_SINGLE, and that of a linked one below LONGEST_LINKED, with which what
# is left of a channel is told to 2e-3; a constant that is free has no end to it.
LEAST_IN_SINGLE, LONGEST_IN_SINGLE, LONGEST_LINKED = 30, 1e7, 1e5


def _by_groups(of: Callable, values: np.ndarray, mapped: Callable) -> np.ndarray:
    """(..., N, M): a function of (V, N, M), of TOGETHER values at a time, one by one or by another
    `mapped`: columns are read once for all of a group."""
    flat = values.reshape(-1, *values.shape[-2:])
    groups = [flat[start : start + TOGETHER] for start in range(0, len(flat), TOGETHER)]
    found = list(mapped(of, groups))
    if len(found) == 1:
        return found[0].reshape(values.shape)
    return np.concatenate(found or [flat]).reshape(values.shape)


class _LowRank:
    """(I + U U^T)^(-1/2) and its relatives, for columns U (K, N, M) that act on every channel
    ("channel"), on every frame ("frame"), on every press ("press", of which frames are by `label`)
    or on all readings at once ("whole"): B blocks that share no reading, with K directions each."""

    def __init__(self, columns: np.ndarray, each: str, label: np.ndarray | None = None):
        self.each, self.shape = each, columns.shape[1:]
        self.of_press = None if label is None else frames_of_presses(label)
        length, turn = np.linalg.eigh(met(columns, columns, each, self.of_press))
        self.length = np.maximum(length, 0.0)
        scale = np.where(self.length > 0.0, self.length, 1.0) ** -0.5
        self.columns = self._turned(columns, turn * scale[:, None, :])

    def _turned(self, columns: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """(J, N, M): sums of columns (K, N, M) with weights (B, K, J)."""
        if self.each == "whole":
            found = turn[0].T @ columns.reshape(len(columns), -1)
            return found.reshape(-1, *self.shape)
        if self.each == "channel":
            return np.ascontiguousarray((columns.transpose(2, 1, 0) @ turn).transpose(2, 1, 0))
        if self.each == "press":
            assert self.of_press is not None
            turn = np.tensordot(self.of_press.T, turn, axes=1)
        return np.ascontiguousarray((columns.transpose(1, 2, 0) @ turn).transpose(2, 0, 1))

    def _along(self, values: np.ndarray) -> np.ndarray:
        """(B, V, K): products of values (V, N, M) with the units."""
        if self.each == "whole":
            flat = self.columns.reshape(len(self.columns), -1)
            return (values.reshape(len(values), -1) @ flat.T)[None]
        if self.each == "channel":
            each = [np.einsum("nm,knm->km", value, self.columns) for value in values]
            return np.array(each).transpose(2, 0, 1)
        found = values.transpose(1, 0, 2) @ self.columns.transpose(1, 2, 0)
        if self.each != "press":
            return found
        assert self.of_press is not None
        return np.tensordot(self.of_press, found, axes=1)

    def _sum(self, amount: np.ndarray) -> np.ndarray:
        """(V, N, M): the units, `amount` (B, V, K) of each."""
        if self.each == "whole":
            flat = self.columns.reshape(len(self.columns), -1)
            return (amount[0] @ flat).reshape(-1, *self.shape)
        if self.each == "channel":
            each = np.ascontiguousarray(amount.transpose(1, 2, 0))
            found = np.empty((len(each), *self.shape), np.result_type(each, self.columns))
            for own, into in zip(each, found, strict=True):
                np.einsum("km,knm->nm", own, self.columns, out=into)
            return found
        if self.each == "press":
            assert self.of_press is not None
            amount = np.tensordot(self.of_press.T, amount, axes=1)
        return (amount @ self.columns.transpose(1, 0, 2)).transpose(1, 0, 2)

    def apply(self, values: np.ndarray, more: np.ndarray) -> np.ndarray:
        """(..., N, M): values, and `more` (B, K) times their parts along the units."""

        def applied(own: np.ndarray) -> np.ndarray:
            found = self._sum(self._along(own) * more[:, None])
            found += own
            return found

        return _by_groups(applied, values, map)

    @property
    def in_single(self) -> "_LowRank":
        """The same in single precision."""
        found = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                vars(found)[name] = value.astype(np.float32)
        return found

    @cached_property
    def root(self) -> np.ndarray:
        """(B, K), for `apply`: the inverse root."""
        return 1.0 / np.sqrt(1.0 + self.length) - 1.0

    @cached_property
    def precision(self) -> np.ndarray:
        """(B, K), for `apply`: the inverse."""
        return -self.length / (1.0 + self.length)

    @cached_property
    def unroot(self) -> np.ndarray:
        """(B, K), for `apply`: the root."""
        return np.sqrt(1.0 + self.length) - 1.0

    @cached_property
    def log_determinant(self) -> float:
        """Of I + U U^T."""
        return float(np.log1p(self.length).sum())


class _Linked(_LowRank):
    """The same for columns C (L, N, M) of every channel as parts F of the frames and P of the
    presses have left them: P F C, which is in other channels too."""

    def __init__(self, columns: np.ndarray, before: list[_LowRank]):
        self.each, self.shape, self.before = "linked", columns.shape[1:], before
        self.own = columns
        length, turn = np.linalg.eigh(self._gram())
        there = length > TINY
        self.length = length[None, there]
        self.turn = turn[:, there] / np.sqrt(length[there])

    def _gram(self) -> np.ndarray:
        """(LM, LM): (P F C)^T P F C, by the units of frames and of presses."""
        count, width = len(self.own), self.shape[1]
        found = np.zeros((count, width, count, width))
        channel = np.arange(width)
        found[:, channel, :, channel] = np.einsum("knm,lnm->mkl", self.own, self.own)
        gram = found.reshape(count * width, -1)
        for number, part in enumerate(self.before):
            units = part.columns
            for one in reversed(self.before[:number]):
                units = one.apply(units, one.root)
            along = self.own[:, None] * units
            if part.each == "press":
                along = part.of_press @ along
            # (LM, K, B), B frames or presses.
            along = along.transpose(0, 3, 1, 2).reshape(count * width, len(units), -1)
            gram += np.einsum("ckb,bk,dkb->cd", along, part.precision, along, optimize=True)
        return gram

    def apply(self, values: np.ndarray, more: np.ndarray) -> np.ndarray:
        """(..., N, M): values, and `more` (1, K) times their parts along the units."""
        flat = values.reshape(-1, *self.shape)
        back = flat
        for part in reversed(self.before):
            back = part.apply(back, part.root)
        along = np.einsum("lnm,vnm->vlm", self.own, back)
        there = along.reshape(len(flat), len(self.turn))
        there = ((there @ self.turn) * more[0]) @ self.turn.T
        moved = np.einsum("lnm,vlm->vnm", self.own, there.reshape(along.shape))
        for part in self.before:
            moved = part.apply(moved, part.root)
        return values + moved.reshape(values.shape)


def frames_of_presses(label: np.ndarray) -> np.ndarray:
    """(B, N): whether a frame is of a press, 0 or 1; label (N,): which it is of, -1 none."""
    return (np.unique(label[label >= 0])[:, None] == label).astype(float)


def met(a: np.ndarray, b: np.ndarray, each: str, of_press: np.ndarray | None = None) -> np.ndarray:
    """(B, J, K) sums of the products of columns (J, N, M) and (K, N, M) over each of the B frames,
    presses (of_press (B, N)) or channels, or over all readings, which one error acts on."""
    if each == "whole":
        return (a.reshape(len(a), -1) @ b.reshape(len(b), -1).T)[None]
    if each == "channel":
        left, right = (np.ascontiguousarray(own.transpose(2, 0, 1)) for own in (a, b))
        return left @ right.transpose(0, 2, 1)
    found = a.transpose(1, 0, 2) @ b.transpose(1, 2, 0)
    if each != "press":
        return found
    return (of_press @ found.reshape(len(found), -1)).reshape(-1, len(a), len(b))


@dataclass(frozen=True)
class Whitening:
    """Square root of the inverse covariance of readings (N, M), applied.

    Every channel has noise of sd (M,), with the `correlation` of AR(1) from one frame to the next
    by their numbers `clock` (N,), ascending, or else in a row, and one constant error, the same in
    all frames, of variance rho sd^2; rho (M,) is infinite where the values are differences from one
    baseline. mask (N, M): readings that are there. errors: what a rig adds. Those of a frame count
    as independent from frame to frame in what is whitened in time already; those of a channel as
    they are in what frames and presses have left.
    """

    mask: np.ndarray
    sd: np.ndarray
    rho: np.ndarray
    correlation: float = 0.0
    errors: RigErrors | None = field(default=None, repr=False)
    clock: np.ndarray | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls, voltage: np.ndarray, sd: np.ndarray, difference: bool, error: np.ndarray
    ) -> "Whitening":
        """For readings (N, M), NaN where lost, noise sd (M,) and a coherent error's sd (M,)."""
        rho = np.full(sd.shape, np.inf) if difference else (error / sd) ** 2
        return cls(np.isfinite(voltage), sd, rho)

    @property
    def size(self) -> int:
        """Number of readings, less those that a free constant takes."""
        free = np.isinf(self.rho) & self.mask.any(axis=0)
        return int(self.mask.sum() - free.sum())

    @property
    def by_channel(self) -> bool:
        """Whether what is whitened stays within its channel."""
        if self.errors is None:
            return True
        press = 0 if self.errors.press is None else len(self.errors.press)
        return not (len(self.errors.frame) or len(self.errors.whole) or press)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """(..., N, M) whitened, 0 where lost."""
        parts = self.parts

        def whitened(own: np.ndarray) -> np.ndarray:
            found = self._filtered(own)
            for part in parts:
                found = part.apply(found, part.root)
            return np.where(self.mask, found, 0.0)

        return _by_groups(whitened, values, cores.threaded)

    def back(self, whitened: np.ndarray) -> np.ndarray:
        """(..., N, M): the transpose of whitening, applied; of what is whitened, the inverse
        covariance times what it was."""
        found = whitened
        for part in reversed(self.parts):
            found = part.apply(found, part.root)
        return self._filtered_back(found)

    def undone(self, whitened: np.ndarray) -> np.ndarray:
        """(..., N, M) as they were before they were whitened, 0 where lost; a constant that is
        free stays taken out."""
        found = whitened
        for part in reversed(self.parts):
            found = part.apply(found, part.unroot)
        if self.correlation:
            previous, share, scale = self._chain
            found = found / scale
            channel = np.arange(found.shape[-1])
            for row in range(1, found.shape[-2]):
                found[..., row, :] += share[row] * found[..., previous[row], channel]
        return np.where(self.mask, found, 0.0) * self.sd

    def channel_lengths(self, column: np.ndarray, channels: np.ndarray) -> np.ndarray:
        """(C,): squared whitened length of what column (N, M) is in each of some channels alone."""
        if self.by_channel:
            return (self(column) ** 2).sum(axis=0)[channels].astype(float)

        def lengths(start: int) -> np.ndarray:
            at = channels[start : start + TOGETHER]
            alone = np.zeros((len(at), *column.shape), column.dtype)
            alone[np.arange(len(at)), :, at] = column[:, at].T
            return (self(alone) ** 2).sum(axis=(1, 2)).astype(float)

        groups = cores.threaded(lengths, range(0, len(channels), TOGETHER))
        return np.concatenate([np.zeros(0), *groups])

    def filtered(self, columns: np.ndarray, each: str) -> np.ndarray:
        """(K, N, M): columns of errors in units of the noise, as the filter in time leaves them."""
        if each == "frame":
            return np.where(self.mask, columns, 0.0) / self.sd * self._louder[:, None]
        return self._filtered(columns)

    def entered(self, columns: np.ndarray, each: str) -> np.ndarray:
        """(K, N, M): columns of `filtered` errors as they are where these are taken out."""
        return self._entered(columns, each, self.parts)

    @staticmethod
    def _entered(columns: np.ndarray, each: str, parts: list[_LowRank]) -> np.ndarray:
        for part in parts:
            if each == "press" and part.each == "frame":
                columns = part.apply(columns, part.root)
        return columns

    def left(self, whitened: np.ndarray, each: str) -> np.ndarray:
        """(..., N, M): of what is whitened, what errors as of `entered` are compared with."""
        for part in reversed(self.parts[self._free :]):
            if ORDER.index(part.each) >= ORDER.index(each):
                whitened = part.apply(whitened, part.root)
        return whitened

    @cached_property
    def log_determinant(self) -> float:
        """Of the covariance over that of the noise's variances alone; free constants aside."""
        total = sum(part.log_determinant for part in self.parts[self._free :])
        return total - 2.0 * float(np.log(self._chain[2]).sum()) if self.correlation else total

    @property
    def _free(self) -> int:
        return int(np.isinf(self.rho).any())

    @cached_property
    def _number(self) -> np.ndarray:
        """(N,): the numbers of the frames."""
        return np.arange(float(len(self.mask))) if self.clock is None else self.clock.astype(float)

    @cached_property
    def _louder(self) -> np.ndarray:
        """(N,): length of one frame's error after the filter for noise of this correlation, as if
        frames went on at both ends."""
        steps = np.concatenate([[1.0], np.diff(self._number), [1.0]])
        repeated = self.correlation ** (2.0 * steps)
        return np.sqrt(1.0 / (1.0 - repeated[:-1]) + repeated[1:] / (1.0 - repeated[1:]))

    @cached_property
    def _chain(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(N, M) each: the frame of a channel's reading before, what of it the next one repeats,
        and one over the sd of what is new."""
        rows = np.arange(len(self.mask))[:, None]
        there = np.maximum.accumulate(np.where(self.mask, rows, -1), axis=0)
        previous = np.vstack([np.full((1, self.mask.shape[1]), -1), there[:-1]])
        after = self.mask & (previous >= 0)
        previous = np.maximum(previous, 0)
        apart = np.where(after, self._number[:, None] - self._number[previous], 1.0)
        share = np.where(after, self.correlation**apart, 0.0)
        return previous, share, 1.0 / np.sqrt(1.0 - share**2)

    def _filtered(self, values: np.ndarray) -> np.ndarray:
        scaled = np.where(self.mask, values, 0.0) / self.sd
        if not self.correlation:
            return scaled
        previous, share, scale = self._chain
        at = previous * scaled.shape[-1] + np.arange(scaled.shape[-1])
        flat = scaled.reshape(*scaled.shape[:-2], self.mask.size)
        before = flat.take(at, axis=-1, mode="clip")
        return (scaled - share * before) * scale

    def _filtered_back(self, values: np.ndarray) -> np.ndarray:
        values = np.where(self.mask, values, 0.0)
        if self.correlation:
            previous, share, scale = self._chain
            values = values * scale
            rows, channels = np.nonzero(share)
            later = share[rows, channels] * values[..., rows, channels]
            values[..., previous[rows, channels], channels] -= later
        return np.where(self.mask, values, 0.0) / self.sd

    def __getstate__(self) -> dict:
        """Without `parts`: what they take to find is less than what they are."""
        return {name: value for name, value in vars(self).items() if name != "parts"}

    def forget(self) -> None:
        """Let go of `parts`, which are found anew where they are asked for."""
        vars(self).pop("parts", None)

    @property
    def in_single(self) -> "Whitening":
        """The same in single precision; itself where that would not do."""

        def long(part: _LowRank) -> bool:
            most = LONGEST_LINKED if isinstance(part, _Linked) else LONGEST_IN_SINGLE
            return bool(part.length.max(initial=0.0) > most)

        if min(self.mask.shape) < LEAST_IN_SINGLE or any(map(long, self.parts)):
            return self
        found = replace(self, sd=self.sd.astype(np.float32))
        vars(found)["parts"] = parts = [part.in_single for part in self.parts]
        for number, part in enumerate(parts):
            if isinstance(part, _Linked):
                part.before = parts[:number]
        if self.correlation:
            previous, *scales = self._chain
            vars(found)["_chain"] = previous, *(one.astype(np.float32) for one in scales)
        return found

    @cached_property
    def parts(self) -> list[_LowRank]:
        """What is of low rank, in the order in which it is taken out, a free constant first."""
        constant = np.where(np.isinf(self.rho), 1.0, np.sqrt(self.rho)) * self.sd
        constant = np.broadcast_to(constant, (1, *self.mask.shape))
        own = {each: np.zeros((0, *self.mask.shape)) for each in ORDER}
        if self.errors is not None:
            own |= {"frame": self.errors.frame, "channel": self.errors.channel}
            own |= {"whole": self.errors.whole}
            for each in ("press", "linked"):
                if getattr(self.errors, each) is not None:
                    own[each] = getattr(self.errors, each)
            if not self.errors.filtered:
                own = {each: self.filtered(columns, each) for each, columns in own.items()}
        constant = self._filtered(constant)
        found: list[_LowRank] = []
        if self._free:
            found.append(_LowRank(constant, "channel"))
            found[0].length = np.full(found[0].length.shape, np.inf)
            # What is taken out for good does not come back.
            found[0].precision = found[0].root = np.full(found[0].length.shape, -1.0)
            found[0].unroot = np.zeros(found[0].length.shape)
        else:
            own["channel"] = np.concatenate([constant, own["channel"]])
        for each in ORDER:
            if len(own[each]):
                columns = self._entered(own[each], each, found)
                if each == "whole":
                    for part in found:
                        columns = part.apply(columns, part.root)
                if each == "linked":
                    found.append(_Linked(columns, found[self._free :]))
                    continue
                label = self.errors.label if self.errors is not None and each == "press" else None
                found.append(_LowRank(columns, each, label))
        return found
