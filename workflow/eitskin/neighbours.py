"""Solved skins that others share with: what depends on rim and electrodes is computed once."""

from eitskin.depth import forward_model
from eitskin.forward import Forward
from eitskin.geometry import Geometry

KEPT = 4


class Neighbours:
    """The latest skin solved of each of a few outlines, the one used last at the end."""

    def __init__(self, *solved: Forward):
        self._solved = list(solved)

    def solve(self, geometry: Geometry, accuracy: str) -> Forward:
        """The forward model of a geometry, sharing with one of the same outline, or with the
        latest."""
        like = next((f for f in self._solved if f.geometry.same_outline(geometry)), None)
        latest = self._solved[-1] if self._solved else None
        found = forward_model(geometry, accuracy, like or latest)
        if like is not None:
            self._solved.remove(like)
        self._solved = [*self._solved, found][-KEPT:]
        return found
