"""The Jacobian of a fit: derivatives of all readings by its coordinates.

A gain or an offset of every channel has as many coordinates as channels, each of which changes one
channel alone: a block of these takes the memory and the time of one column.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

# Bytes of columns that are mapped at once, and of a group where there are more: a function makes
# several copies of what it maps.
WHOLE_BYTES, GROUP_BYTES = 3 << 26, 1 << 25


def in_groups(function: Callable[[np.ndarray], np.ndarray], columns: np.ndarray) -> np.ndarray:
    """(K, ...): a function of columns (K, N, M), evaluated group by group where they are many; it
    must map each column by itself."""
    if columns.nbytes <= WHOLE_BYTES:
        return function(columns)
    size = max(GROUP_BYTES // columns[0].nbytes, 1)
    first_result = function(columns[:size])
    mapped = np.empty((len(columns), *first_result.shape[1:]))
    mapped[:size] = first_result
    for start in range(size, len(columns), size):
        mapped[start : start + size] = function(columns[start : start + size])
    return mapped


@dataclass
class Block:
    """Coordinates (S,) that change one channel each, channels (S,); column (N, M): of each channel
    the derivative by its coordinate, 0 where it has none."""

    coordinates: np.ndarray
    channels: np.ndarray
    column: np.ndarray

    def channel_steps(self, step: np.ndarray) -> np.ndarray:
        """(M,): of a step (P,) the part of each channel's coordinate, 0 where it has none."""
        channel_steps = np.zeros(self.column.shape[1])
        channel_steps[self.channels] = step[self.coordinates]
        return channel_steps


@dataclass
class Jacobian:
    """Derivatives of readings (N, M) by P coordinates: columns (K, N, M) of the
    `column_coordinates` (K,), and blocks of coordinates that change one channel each."""

    columns: np.ndarray
    blocks: list[Block] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.size = len(self.columns) + sum(len(b.coordinates) for b in self.blocks)
        block_coordinates = [b.coordinates for b in self.blocks]
        self.column_coordinates = np.setdiff1d(
            np.arange(self.size), np.concatenate([np.zeros(0, int), *block_coordinates])
        )

    @classmethod
    def from_full(
        cls, full: np.ndarray, exclusive_channels: list[tuple[np.ndarray, np.ndarray]]
    ) -> "Jacobian":
        """From the columns of all coordinates (P, N, M); exclusive_channels: coordinates and
        channels, (S,) each, of every block."""
        blocks = []
        for coordinates, channels in exclusive_channels:
            column = np.zeros(full.shape[1:])
            column[:, channels] = full[coordinates, :, channels].T
            blocks.append(Block(coordinates, channels, column))
        columns = np.delete(
            full, np.concatenate([np.zeros(0, int), *(c for c, _ in exclusive_channels)]), axis=0
        )
        return cls(columns, blocks)

    def full(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(P, N, M): the derivatives, of some frames where `rows` are given."""
        columns = self.columns[:, rows]
        full = np.zeros((self.size, *columns.shape[1:]))
        full[self.column_coordinates] = columns
        for block in self.blocks:
            full[block.coordinates, :, block.channels] = block.column[rows][:, block.channels].T
        return full

    def mapped(self, function: Callable[[np.ndarray], np.ndarray], by_channel: bool) -> "Jacobian":
        """The columns mapped by a linear function of columns (K, N, M); by_channel: whether that
        maps each channel by itself, so that blocks stay blocks."""
        if by_channel:
            blocks = [replace(b, column=function(b.column[None])[0]) for b in self.blocks]
            return Jacobian(in_groups(function, self.columns), blocks)
        return Jacobian(in_groups(function, self.full() if self.blocks else self.columns))

    def set_columns(
        self, coordinates: np.ndarray, channel_masks: np.ndarray, values: np.ndarray
    ) -> None:
        """Set the columns of coordinates (S,): of values (N, M) the channels of each one's mask,
        channel_masks (S, M) bool."""
        for block in self.blocks:
            if np.array_equal(block.coordinates, coordinates):
                block.column = values * channel_masks.any(axis=0)
                return
        self.columns[np.searchsorted(self.column_coordinates, coordinates)] = (
            channel_masks[:, None, :] * values
        )

    def change_along(self, step: np.ndarray) -> np.ndarray:
        """(N, M): the change of the readings by a step (P,), to first order."""
        change = np.tensordot(step[self.column_coordinates], self.columns, 1)
        for block in self.blocks:
            change = change + block.channel_steps(step) * block.column
        return change

    def products_with(self, values: np.ndarray) -> np.ndarray:
        """(P,): inner products of the columns with values (N, M)."""
        products = np.empty(self.size)
        products[self.column_coordinates] = (
            self.columns.reshape(len(self.column_coordinates), -1) @ values.ravel()
        )
        for block in self.blocks:
            products[block.coordinates] = (block.column * values).sum(axis=0)[block.channels]
        return products

    def gram(self) -> np.ndarray:
        """(P, P): inner products of all columns."""
        gram = np.zeros((self.size, self.size))
        flat = self.columns.reshape(len(self.column_coordinates), -1)
        gram[np.ix_(self.column_coordinates, self.column_coordinates)] = flat @ flat.T
        for i, block in enumerate(self.blocks):
            shared = np.einsum("knm,nm->km", self.columns, block.column)[:, block.channels]
            gram[np.ix_(self.column_coordinates, block.coordinates)] = shared
            gram[np.ix_(block.coordinates, self.column_coordinates)] = shared.T
            for block_2 in self.blocks[: i + 1]:
                common, index, index_2 = np.intersect1d(
                    block.channels, block_2.channels, assume_unique=True, return_indices=True
                )
                products = (block.column * block_2.column).sum(axis=0)[common]
                rows, columns = block.coordinates[index], block_2.coordinates[index_2]
                gram[rows, columns] = gram[columns, rows] = products
        return gram

    def broyden_update(self, step: np.ndarray, excess: np.ndarray) -> None:
        """Broyden's (1965) update, Schubert's (1970) where coordinates change one channel each;
        excess (N, M): what the readings changed by in a step (P,), less `change_along` it."""
        block_steps = [block.channel_steps(step) for block in self.blocks]
        length = (step[self.column_coordinates] ** 2).sum() + sum(s**2 for s in block_steps)
        share = excess / np.where(length > 0.0, length, 1.0)
        for column, column_step in zip(self.columns, step[self.column_coordinates], strict=True):
            column += column_step * share
        for block, channel_steps in zip(self.blocks, block_steps, strict=True):
            block.column += channel_steps * share
