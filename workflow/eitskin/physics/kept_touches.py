"""Touched places that a skin remembers: what a touch there is to it, whatever its contrast."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from eitskin.physics.column_touch import ColumnTouch
    from eitskin.physics.patch import PatchedTouch
    from eitskin.physics.touch import TouchEdge

KEPT_BYTES = 1 << 26  # the oldest go first

Place = tuple[float, float, float]
Met = tuple["TouchEdge | PatchedTouch | ColumnTouch", np.ndarray]


class KeptTouches:
    """By place (x_mm, y_mm, radius_mm) the touch's edge and its coupling (n order, K) to the
    electrodes' modes, of the places met last, within KEPT_BYTES."""

    def __init__(self):
        self._met: dict[Place, Met] = {}
        self._nbytes = 0

    def __contains__(self, place: Place) -> bool:
        return place in self._met

    def get(self, place: Place, meet: Callable[[], Met]) -> Met:
        """What is kept of a place, else what `meet` finds there."""
        if place not in self._met:
            found = meet()
            self._nbytes += _nbytes(found)
            while self._met and self._nbytes > KEPT_BYTES:
                self._nbytes -= _nbytes(self._met.pop(next(iter(self._met))))
            self._met[place] = found
        return self._met[place]


def array_nbytes(thing: object) -> int:
    """Bytes of the arrays among the attributes of an object."""
    return sum(part.nbytes for part in vars(thing).values() if isinstance(part, np.ndarray))


def _nbytes(met: Met) -> int:
    return sum(part.nbytes for part in met)
