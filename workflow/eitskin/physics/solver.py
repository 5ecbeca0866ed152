"""The forward model of a geometry, and solved skins whose parts later ones share: what depends on
rim and electrodes alone is computed once."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from eitskin import cores
from eitskin.physics.depth import DepthForward, span
from eitskin.physics.forward import Accuracy, Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.patch import PatchForward

MAX_SKINS, MAX_BYTES = 4, 5 << 28  # 1.25 GiB: of large bodies fewer than MAX_SKINS are kept

Part = TypeVar("Part")
Result = TypeVar("Result")


def forward_model(
    geometry: Geometry,
    accuracy: str | Accuracy = "diagnose",
    donor: Forward | None = None,
    lends_parts: bool = False,
) -> Forward:
    """The forward model of a geometry: of a sheet, of a skin with patches or of a body. It shares
    with `donor`, a solved skin, the parts in which they agree; lends_parts: whether it only lends
    its own (`Forward`)."""
    if any(patch.contrast != 1.0 for patch in geometry.patches):
        bare = donor.bare if isinstance(donor, PatchForward) else donor
        bare_geometry = geometry.with_values(patches=())
        if bare is None or not bare.is_model_of(bare_geometry, accuracy):
            bare = forward_model(bare_geometry, accuracy, bare, lends_parts=True)
        return PatchForward(bare, geometry, donor)
    if isinstance(donor, PatchForward):
        donor = donor.bare
    heights = span(geometry)
    if heights is None:
        return Forward(geometry, accuracy, donor, lends_parts)
    return DepthForward(geometry, heights, accuracy, donor=donor, lends_parts=lends_parts)


def skin_capacity(nbytes: int) -> int:
    """How many solved skins of this size are kept at once."""
    return max(min(MAX_SKINS, MAX_BYTES // max(nbytes, 1)), 1)


class EffortExceeded(Exception):
    """The effort of the skins solved so far exceeds its limit."""


class SolvedSkins:
    """The latest solved skin of each of a few outlines, in order of use.

    effort: cost of all skins solved and places touched so far, in units of one solved sheet. It
    counts operations, not seconds, so that a search with a limit stops at the same point on every
    machine.
    """

    def __init__(self, *solved: Forward):
        self._solved = list(solved)
        self.effort, self.effort_limit = 0.0, math.inf

    @contextmanager
    def within(self, limit: float) -> Iterator[None]:
        """A context in which `solve` raises EffortExceeded once `effort` is above `limit`, or
        above the limit of an outer context."""
        outer_limit, self.effort_limit = self.effort_limit, min(limit, self.effort_limit)
        try:
            yield
        finally:
            self.effort_limit = outer_limit

    def forked(
        self, solve: Callable[[Part], Result], parts: Iterable[Part], shared: Sequence[Any] = ()
    ) -> list[Result]:
        """The results of `solve` for each part, by cores.forked; the effort of every part is
        added to `effort`."""
        effort_before = self.effort

        def counted(part: Part) -> tuple[Result, float]:
            self.effort = effort_before
            return solve(part), self.effort - effort_before

        costed = cores.forked(counted, parts, shared)
        self.effort = effort_before + sum(cost for _, cost in costed)
        return [value for value, _ in costed]

    def solve(self, geometry: Geometry, accuracy: str) -> Forward:
        """The forward model of a geometry, sharing with the solved skin of the same outline, or
        with the latest. Raises EffortExceeded."""
        if self.effort > self.effort_limit:
            raise EffortExceeded
        same_outline = next(
            (skin for skin in self._solved if skin.geometry.same_outline(geometry)), None
        )
        latest_skin = self._solved[-1] if self._solved else None
        forward = forward_model(geometry, accuracy, same_outline or latest_skin)
        self.effort += forward.effort
        if same_outline is not None:
            self._solved.remove(same_outline)
        self._solved = [*self._solved, forward][-skin_capacity(forward.nbytes) :]
        return forward
