"""Derivatives of all readings by what is fitted: a full column each, or one for a channel each.

A gain or an offset of every channel has as many coordinates as channels, each of which moves its
own channel alone: together they take one column's room, and one column's time.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

# Bytes of columns: up to these they are mapped at once, more of them in groups of so many. On the
# way they are there several times over.
AT_ONCE, GROUP = 3 << 26, 1 << 25


def in_groups(of: Callable[[np.ndarray], np.ndarray], columns: np.ndarray) -> np.ndarray:
    """(K, ...): a function of columns (K, N, M) that maps each by itself."""
    if columns.nbytes <= AT_ONCE:
        return of(columns)
    size = max(GROUP // columns[0].nbytes, 1)
    first = of(columns[:size])
    found = np.empty((len(columns), *first.shape[1:]))
    found[:size] = first
    for start in range(size, len(columns), size):
        found[start : start + size] = of(columns[start : start + size])
    return found


@dataclass
class Block:
    """Coordinates (S,) that move one channel each, channels (S,); column (N, M), 0 elsewhere."""

    coordinates: np.ndarray
    channels: np.ndarray
    column: np.ndarray

    def spread(self, step: np.ndarray) -> np.ndarray:
        """(M,): the step (P,) of each channel's own coordinate, 0 where it has none."""
        found = np.zeros(self.column.shape[1])
        found[self.channels] = step[self.coordinates]
        return found


@dataclass
class Jacobian:
    """Derivatives of readings (N, M) by P coordinates: columns (K, N, M) of those `at` (K,), and
    blocks of those with channels of their own."""

    columns: np.ndarray
    blocks: list[Block] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.size = len(self.columns) + sum(len(b.coordinates) for b in self.blocks)
        own = [b.coordinates for b in self.blocks]
        self.at = np.setdiff1d(np.arange(self.size), np.concatenate([np.zeros(0, int), *own]))

    @classmethod
    def of(cls, full: np.ndarray, own: list[tuple[np.ndarray, np.ndarray]]) -> "Jacobian":
        """From every coordinate's column (P, N, M); own: coordinates and channels, (S,) each, of
        the blocks."""
        blocks = []
        for coordinates, channels in own:
            column = np.zeros(full.shape[1:])
            column[:, channels] = full[coordinates, :, channels].T
            blocks.append(Block(coordinates, channels, column))
        whole = np.delete(full, np.concatenate([np.zeros(0, int), *(c for c, _ in own)]), axis=0)
        return cls(whole, blocks)

    def full(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(P, N, M), of some rows where these are given."""
        columns = self.columns[:, rows]
        found = np.zeros((self.size, *columns.shape[1:]))
        found[self.at] = columns
        for block in self.blocks:
            found[block.coordinates, :, block.channels] = block.column[rows][:, block.channels].T
        return found

    def mapped(self, of: Callable[[np.ndarray], np.ndarray], by_channel: bool) -> "Jacobian":
        """Every coordinate's column mapped by a linear function of columns (K, N, M); by_channel:
        whether that keeps each channel's own."""
        if by_channel:
            blocks = [replace(b, column=of(b.column[None])[0]) for b in self.blocks]
            return Jacobian(in_groups(of, self.columns), blocks)
        return Jacobian(in_groups(of, self.full() if self.blocks else self.columns))

    def put(self, coordinates: np.ndarray, own: np.ndarray, values: np.ndarray) -> None:
        """Columns of coordinates (S,): of values (N, M) the channels that are each one's own, own
        (S, M)."""
        for block in self.blocks:
            if np.array_equal(block.coordinates, coordinates):
                block.column = values * own.any(axis=0)
                return
        self.columns[np.searchsorted(self.at, coordinates)] = own[:, None, :] * values

    def along(self, step: np.ndarray) -> np.ndarray:
        """(N, M): the change of the readings along a step (P,)."""
        found = np.tensordot(step[self.at], self.columns, 1)
        for block in self.blocks:
            found = found + block.spread(step) * block.column
        return found

    def against(self, values: np.ndarray) -> np.ndarray:
        """(P,): products with values (N, M)."""
        found = np.empty(self.size)
        found[self.at] = self.columns.reshape(len(self.at), -1) @ values.ravel()
        for block in self.blocks:
            found[block.coordinates] = (block.column * values).sum(axis=0)[block.channels]
        return found

    def gram(self) -> np.ndarray:
        """(P, P): products of all columns."""
        found = np.zeros((self.size, self.size))
        flat = self.columns.reshape(len(self.at), -1)
        found[np.ix_(self.at, self.at)] = flat @ flat.T
        for i, block in enumerate(self.blocks):
            shared = np.einsum("knm,nm->km", self.columns, block.column)[:, block.channels]
            found[np.ix_(self.at, block.coordinates)] = shared
            found[np.ix_(block.coordinates, self.at)] = shared.T
            for other in self.blocks[: i + 1]:
                common, here, there = np.intersect1d(
                    block.channels, other.channels, assume_unique=True, return_indices=True
                )
                both = (block.column * other.column).sum(axis=0)[common]
                mine, others = block.coordinates[here], other.coordinates[there]
                found[mine, others] = found[others, mine] = both
        return found

    def learn(self, step: np.ndarray, missed: np.ndarray) -> None:
        """Broyden's (1965) update, Schubert's (1970) where coordinates have channels of their own:
        after a step (P,), `missed` (N, M) is what the readings changed by beyond `along`."""
        spreads = [block.spread(step) for block in self.blocks]
        length = (step[self.at] ** 2).sum() + sum(s**2 for s in spreads)
        share = missed / np.where(length > 0.0, length, 1.0)
        for column, own in zip(self.columns, step[self.at], strict=True):
            column += own * share
        for block, spread in zip(self.blocks, spreads, strict=True):
            block.column += spread * share
