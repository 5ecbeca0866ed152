"""Whether some channels, such as an electrode's, say other things than the rest."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from eitskin.exported.channels import KEPT, Channels


def using(table: np.ndarray, electrodes: Iterable[int]) -> np.ndarray:
    """(M,) bool: the channels of a table (M, 4) that use any of the electrodes."""
    return np.asarray(np.isin(table, list(electrodes)).any(axis=1))


class Electrodes:
    """The electrodes of a table of channels (M, 4), each with the channels that use it."""

    def __init__(self, channels: Channels, table: np.ndarray):
        self.channels = channels
        count = int(table.max()) + 1
        self.groups = [np.flatnonzero(using(table, [k])) for k in range(count)]
        self._covariance = lru_cache(KEPT)(self._covariance_of)
        self._single = [1.0 / np.diag(own) for own in channels.precision]
        for number in range(len(channels.precision)):
            for k in range(count):
                self._covariance(number, k, ())

    def _covariance_of(
        self, number: int, electrode: int, gone: tuple[int, ...]
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """An electrode's channels and those that are gone, their covariance given the others, and
        how many channels the electrode has beside those."""
        group = np.union1d(self.groups[electrode], np.array(gone, dtype=int))
        own = self.channels.precision[number]
        return group, np.linalg.inv(own[np.ix_(group, group)]), len(group) - len(gone)

    def apart(self, pull: np.ndarray, number: int, gone: tuple[int, ...] = ()) -> np.ndarray:
        """(n,): a channel's share of each electrode's squared distance from what the others say,
        over its conditional covariance; 0 for an electrode without channels.

        `pull`: the precision of the class of strength `number` times a change (M,) in units of
        spread, in which channels that are `gone` are what the others say.
        """
        shares = np.zeros(len(self.groups))
        for k in range(len(shares)):
            group, covariance, count = self._covariance(number, k, gone)
            if count:
                shares[k] = pull[group] @ covariance @ pull[group] / count
        return shares

    def pull(self, whole: np.ndarray, number: int) -> np.ndarray:
        """(M,): what `apart` and `singles` take, of a change (M,) in units of spread."""
        return self.channels.precision[number] @ whole

    def singles(self, pull: np.ndarray, number: int) -> np.ndarray:
        """(M,): each channel's squared distance from what the others say."""
        return np.square(pull) * self._single[number]

    def oddest(self, whole: np.ndarray, number: int) -> tuple[float, float]:
        """The largest of `singles`, and of `apart`."""
        pull = self.pull(whole, number)
        return float(self.singles(pull, number).max()), float(self.apart(pull, number).max())
