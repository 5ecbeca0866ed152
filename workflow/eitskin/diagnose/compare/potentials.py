"""What other channels would read, from those that were read, by linearity alone.

A reading is (e_source - e_sink) · Z (e_plus - e_minus), Z the transfer impedances of the electrodes
(n, n). Readings that are sums and differences of others follow from these, without a model of the
skin and without reciprocity, whatever the pattern: so does what crossed wires would read.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

SPANNED = 1e-6  # of a channel's length that may lie outside of what was read


@dataclass(frozen=True)
class Potentials:
    """Channels (M, 4) of n electrodes: source, sink, plus, minus; read (M,): which have values."""

    channels: np.ndarray
    n: int
    read: np.ndarray
    _crossed: dict[tuple[int, int], np.ndarray] = field(default_factory=dict, repr=False)

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Pseudo-inverse of what was read (n², M), and what it leaves open (n², q)."""
        rows = np.zeros((len(self.channels), self.n, self.n))
        k = np.arange(len(self.channels))
        source, sink, plus, minus = self.channels.T
        for drive, current in ((source, 1.0), (sink, -1.0)):
            for electrode, sign in ((plus, 1.0), (minus, -1.0)):
                rows[k, drive, electrode] += current * sign
        rows[~self.read] = 0.0
        left, size, right = np.linalg.svd(rows.reshape(len(k), -1), full_matrices=True)
        rank = int((size > SPANNED * size[0]).sum())
        inverse = (right[:rank].T / size[:rank]) @ left[:, :rank].T
        return inverse, right[rank:].T

    def impedances(self, values: np.ndarray) -> np.ndarray:
        """(n, n): the least transfer impedances that give the values (M,) that were read."""
        return (self._factors[0] @ np.where(self.read, values, 0.0)).reshape(self.n, self.n)

    def crossed(self, impedances: np.ndarray, a: int, b: int) -> tuple[np.ndarray, np.ndarray]:
        """What the channels read once the wires of a and b are exchanged (M,), and which of them
        follow from what was read (M,)."""
        wires = np.arange(self.n)
        wires[[a, b]] = b, a
        return _between(impedances, wires[self.channels]), self._known(a, b)

    def _known(self, a: int, b: int) -> np.ndarray:
        if (a, b) not in self._crossed:
            known = self.read.copy()
            moved = np.isin(self.channels, (a, b)).any(axis=1)
            wires = np.arange(self.n)
            wires[[a, b]] = b, a
            open_ = self._factors[1].reshape(self.n, self.n, -1)
            missed = np.abs(_between(open_, wires[self.channels[moved]]))
            known[moved] = (missed < SPANNED).all(axis=-1)
            self._crossed[a, b] = known
        return self._crossed[a, b]


def _between(impedances: np.ndarray, channels: np.ndarray) -> np.ndarray:
    """(M, ...): what channels (M, 4) read of impedances (n, n, ...)."""
    source, sink, plus, minus = channels.T
    from_source = impedances[source, plus] - impedances[source, minus]
    return from_source - impedances[sink, plus] + impedances[sink, minus]
