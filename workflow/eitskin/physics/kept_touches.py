"""Touched places that a skin remembers: what a touch there is to it, whatever its contrast."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

KEPT_BYTES = 1 << 26  # the oldest go first

Place = tuple[float, float, float]


@dataclass(frozen=True)
class Coupled:
    """A touch's multipoles: mass, response to themselves (K, K) and coupling (n order, K) to the
    electrodes' modes."""

    mass: np.ndarray
    response: np.ndarray
    coupling: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        return self.mass.nbytes + self.response.nbytes + self.coupling.nbytes


@dataclass(frozen=True)
class Entered:
    """A current that enters evenly over a touch: what it makes at the electrodes' modes (n order,)
    and to the touch's multipoles (K,), its power, and the share of it that is inside the touch."""

    to_electrodes: np.ndarray
    to_touch: np.ndarray
    power: float
    inner_power: float

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        return self.to_electrodes.nbytes + self.to_touch.nbytes


class Sized(Protocol):
    """What says how many bytes it takes."""

    @property
    def nbytes(self) -> int: ...


Found = TypeVar("Found", bound=Sized)


class KeptTouches:
    """What was found last of places (x_mm, y_mm, radius_mm), within KEPT_BYTES."""

    def __init__(self) -> None:
        self._found: dict[tuple[type, Place], Any] = {}
        self._nbytes = 0

    def __contains__(self, place: Place) -> bool:
        return (Coupled, place) in self._found

    def get(
        self,
        kind: type[Found],
        place: Place,
        find: Callable[[], Found],
        serves: Callable[[Found], bool] = lambda found: True,
    ) -> Found:
        """What of a kind is kept of a place and serves, else what `find` finds of it, kept where
        it serves."""
        key = kind, place
        if key in self._found and serves(self._found[key]):
            return self._found[key]
        found = find()
        if serves(found):
            if key in self._found:
                self._nbytes -= self._found.pop(key).nbytes
            self._nbytes += found.nbytes
            while self._found and self._nbytes > KEPT_BYTES:
                self._nbytes -= self._found.pop(next(iter(self._found))).nbytes
            self._found[key] = found
        return found
