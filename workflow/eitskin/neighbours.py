"""Solved skins that others share with: what depends on rim and electrodes is computed once."""

import math
from collections.abc import Iterator
from contextlib import contextmanager

from eitskin.depth import forward_model
from eitskin.forward import Forward
from eitskin.geometry import Geometry

KEPT = 4


class Spent(Exception):
    """More skins were asked for than may be solved."""


class Neighbours:
    """The latest skin solved of each of a few outlines, the one used last at the end; `spent`: how
    many sheets could have been solved so far, by skins and by places touched on them.

    It counts operations, not seconds: whoever stops by it stops at the same point everywhere."""

    def __init__(self, *solved: Forward):
        self._solved = list(solved)
        self.spent, self.most = 0.0, math.inf

    @contextmanager
    def within(self, most: float) -> Iterator[None]:
        """Where `solve` raises Spent once `spent` is beyond `most`, or beyond what there is round
        about."""
        around, self.most = self.most, min(most, self.most)
        try:
            yield
        finally:
            self.most = around

    def solve(self, geometry: Geometry, accuracy: str) -> Forward:
        """The forward model of a geometry, sharing with one of the same outline, or with the
        latest. Raises Spent."""
        if self.spent > self.most:
            raise Spent
        like = next((f for f in self._solved if f.geometry.same_outline(geometry)), None)
        latest = self._solved[-1] if self._solved else None
        found = forward_model(geometry, accuracy, like or latest)
        self.spent += found.effort
        if like is not None:
            self._solved.remove(like)
        self._solved = [*self._solved, found][-KEPT:]
        return found
