"""What unread channels would read, from those that were read, by linearity alone.

A reading is (e_source - e_sink) · Z (e_plus - e_minus), Z the transfer impedances (n, n) of the
electrodes. Channels that are sums and differences of others follow from these, whatever the drive
pattern, without a model of the skin and without reciprocity: so do the readings of exchanged wires.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

OUTSIDE = 1e-6  # of a channel's length beyond the span of those read: rounding


@dataclass(frozen=True)
class Potentials:
    """Channels (M, 4) of n electrodes: source, sink, plus, minus; read (M,) bool: with values."""

    channels: np.ndarray
    n: int
    read: np.ndarray
    _determined_by_wires: dict[tuple[int, int], np.ndarray] = field(
        default_factory=dict, repr=False
    )

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Pseudo-inverse (n², M) of the channels that were read, and their null space (n², q)."""
        rows = np.zeros((len(self.channels), self.n, self.n))
        k = np.arange(len(self.channels))
        source, sink, plus, minus = self.channels.T
        for drive, current in ((source, 1.0), (sink, -1.0)):
            for electrode, sign in ((plus, 1.0), (minus, -1.0)):
                rows[k, drive, electrode] += current * sign
        rows[~self.read] = 0.0
        left_vectors, singular_values, right_vectors = np.linalg.svd(
            rows.reshape(len(k), -1), full_matrices=True
        )
        rank = int((singular_values > OUTSIDE * singular_values[0]).sum())
        inverse = (right_vectors[:rank].T / singular_values[:rank]) @ left_vectors[:, :rank].T
        return inverse, right_vectors[rank:].T

    def impedances(self, values: np.ndarray) -> np.ndarray:
        """The transfer impedances (n, n) of least norm that give the values (M,) that were read."""
        return (self._factors[0] @ np.where(self.read, values, 0.0)).reshape(self.n, self.n)

    def exchanged(self, impedances: np.ndarray, a: int, b: int) -> tuple[np.ndarray, np.ndarray]:
        """Readings (M,) once the wires of electrodes a and b are exchanged, and which of them (M,)
        bool follow from what was read."""
        wires = _exchange(self.n, a, b)
        return _readings(impedances, wires[self.channels]), self._determined(a, b)

    def _determined(self, a: int, b: int) -> np.ndarray:
        if (a, b) not in self._determined_by_wires:
            determined = self.read.copy()
            affected = np.isin(self.channels, (a, b)).any(axis=1)
            wires = _exchange(self.n, a, b)
            null_space = self._factors[1].reshape(self.n, self.n, -1)
            undetermined = np.abs(_readings(null_space, wires[self.channels[affected]]))
            determined[affected] = (undetermined < OUTSIDE).all(axis=-1)
            self._determined_by_wires[a, b] = determined
        return self._determined_by_wires[a, b]


def _exchange(n: int, a: int, b: int) -> np.ndarray:
    """The electrode (n,) of each wire, those of a and b exchanged."""
    wires = np.arange(n)
    wires[[a, b]] = b, a
    return wires


def _readings(impedances: np.ndarray, channels: np.ndarray) -> np.ndarray:
    """Readings (M, ...) of channels (M, 4) from impedances (n, n, ...)."""
    source, sink, plus, minus = channels.T
    from_source = impedances[source, plus] - impedances[source, minus]
    return from_source - impedances[sink, plus] + impedances[sink, minus]
