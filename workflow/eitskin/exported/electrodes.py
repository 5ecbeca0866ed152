"""How far single channels, and all channels of an electrode, lie from their conditional mean."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from eitskin.exported.channels import CACHE_SIZE, Channels


def channels_using(table: np.ndarray, electrodes: Iterable[int]) -> np.ndarray:
    """(M,) bool: which channels of a table (M, 4) use any of the electrodes."""
    return np.asarray(np.isin(table, list(electrodes)).any(axis=1))


class Electrodes:
    """The electrodes of a table of channels (M, 4), each with the channels that use it."""

    def __init__(self, channels: Channels, table: np.ndarray):
        self.channels = channels
        count = int(table.max()) + 1
        self.groups = [
            np.flatnonzero(channels_using(table, [electrode])) for electrode in range(count)
        ]
        self._covariance = lru_cache(CACHE_SIZE)(self._covariance_of)
        self._single = [1.0 / np.diag(precision) for precision in channels.precision]
        for class_number in range(len(channels.precision)):
            for electrode in range(count):
                self._covariance(class_number, electrode, ())

    def _covariance_of(
        self, class_number: int, electrode: int, missing_channels: tuple[int, ...]
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """An electrode's channels joined with the missing ones, their covariance given the other
        channels, and the number of the electrode's channels that are not missing."""
        group = np.union1d(self.groups[electrode], np.array(missing_channels, dtype=int))
        precision = self.channels.precision[class_number]
        return (
            group,
            np.linalg.inv(precision[np.ix_(group, group)]),
            len(group) - len(missing_channels),
        )

    def electrode_distances(
        self, weighted_change: np.ndarray, class_number: int, missing_channels: tuple[int, ...] = ()
    ) -> np.ndarray:
        """(n,): the squared Mahalanobis distance of each electrode's channels from their
        conditional mean, per measured channel; 0 for an electrode without any.

        weighted_change (M,): as `precision_weighted` gives it, of a change whose missing channels
        are at their conditional mean.
        """
        shares = np.zeros(len(self.groups))
        for electrode in range(len(shares)):
            group, covariance, count = self._covariance(class_number, electrode, missing_channels)
            if count:
                shares[electrode] = (
                    weighted_change[group] @ covariance @ weighted_change[group] / count
                )
        return shares

    def precision_weighted(self, change: np.ndarray, class_number: int) -> np.ndarray:
        """(M,): P z of a change z (M,) in units of spread."""
        return self.channels.precision[class_number] @ change

    def channel_distances(self, weighted_change: np.ndarray, class_number: int) -> np.ndarray:
        """(M,): each channel's squared distance from its conditional mean, in standard deviations:
        (P z)² / P_mm."""
        return np.square(weighted_change) * self._single[class_number]

    def largest_distances(self, change: np.ndarray, class_number: int) -> tuple[float, float]:
        """The largest of `channel_distances`, and of `electrode_distances`."""
        weighted_change = self.precision_weighted(change, class_number)
        return float(self.channel_distances(weighted_change, class_number).max()), float(
            self.electrode_distances(weighted_change, class_number).max()
        )
