"""Which forward model a skin asks for, and solved skins that others share with: what depends on
rim and electrodes is computed once."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from eitskin import cores
from eitskin.physics.depth import DepthForward, span
from eitskin.physics.forward import Accuracy, Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.patch import PatchForward

KEPT, KEPT_BYTES = 4, 5 << 28  # of skins; of large bodies fewer are kept

Part = TypeVar("Part")
Result = TypeVar("Result")


def forward_model(
    geometry: Geometry, accuracy: str | Accuracy = "diagnose", near: Forward | None = None
) -> Forward:
    """The forward model that a geometry asks for: a sheet's, a patched one's, or a body's, sharing
    with `near` what they have alike."""
    if geometry.patch is not None and geometry.patch.contrast != 1.0:
        bare = near.bare if isinstance(near, PatchForward) else near
        bare = forward_model(geometry.with_values(patch=None), accuracy, bare)
        return PatchForward(bare, geometry, near)
    if isinstance(near, PatchForward):
        near = near.bare
    heights = span(geometry)
    if heights is None:
        return Forward(geometry, accuracy, near)
    return DepthForward(geometry, heights, accuracy, near=near)


def kept(nbytes: int) -> int:
    """How many solved skins of so many bytes are kept at once."""
    return max(min(KEPT, KEPT_BYTES // max(nbytes, 1)), 1)


class Spent(Exception):
    """More skins were asked for than may be solved."""


class SolvedSkins:
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

    def forked(
        self, of: Callable[[Part], Result], parts: Iterable[Part], shared: Sequence[Any] = ()
    ) -> list[Result]:
        """As `cores.forked`; what each part solves counts as spent here."""
        begun = self.spent

        def counted(part: Part) -> tuple[Result, float]:
            self.spent = begun
            return of(part), self.spent - begun

        found = cores.forked(counted, parts, shared)
        self.spent = begun + sum(cost for _, cost in found)
        return [result for result, _ in found]

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
        self._solved = [*self._solved, found][-kept(found.nbytes) :]
        return found
