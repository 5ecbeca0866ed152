"""Who solves the skin: bodies with one interface (`boundary.Body`), and what each can do."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from witness import boundary, disc, elements, slab
from witness.boundary import Resolution
from witness.curves import Shape
from witness.deep import DeepBody, Depth
from witness.outside import OUTSIDE, OUTSIDE_SOLID, Outside
from witness.slab import Solid
from witness.strengths import DRAWN
from witness.unseen import UNSEEN

AnyBody = boundary.Body | DeepBody | elements.Body | disc.Body | slab.Body

LAWS: dict[str, type[Outside]] = OUTSIDE | OUTSIDE_SOLID | UNSEEN  # outside the catalogue


@dataclass(frozen=True)
class Drawing:
    """What a body is made of: as `boundary.Body` has it, and the depth."""

    shape: Shape
    deg: np.ndarray
    width_mm: np.ndarray
    depth: Depth | Solid | None
    clearance_mm: float | None
    resolution: Resolution | None


@dataclass(frozen=True)
class Generator:
    """body: makes one of its drawing; unable: the laws of `strengths.DRAWN`, `outside` and `unseen`
    that it does not solve; least_level: the least noise, over the median |v|, that its cases may
    have: three times its own error; solid: whether its depth is a `slab.Solid`, whatever the laws.
    """

    name: str
    body: Callable[[Drawing], AnyBody]
    unable: frozenset[str]
    least_level: float
    solid: bool = False

    def does(self, law: str) -> bool:
        """Whether it solves a law's skin."""
        return law in {*DRAWN, *LAWS} and law not in self.unable

    def can(self, kind: str) -> bool:
        """Whether `cases.draw` can draw a kind with it: null, pair, triple, single:<name> or
        outside:<law>; in sets it draws what it does."""
        word, _, name = kind.partition(":")
        if word in ("single", "outside"):
            return self.does(name)
        return kind in ("null", "pair", "triple")


def _boundary(of: Drawing) -> boundary.Body | DeepBody:
    rest = of.clearance_mm, of.resolution
    if of.depth is None:
        return boundary.Body(of.shape, of.deg, of.width_mm, *rest)
    assert isinstance(of.depth, Depth)
    return DeepBody(of.shape, of.deg, of.width_mm, of.depth, *rest)


def _elements(of: Drawing) -> elements.Body:
    if of.depth is not None:
        raise ValueError("triangles are those of a sheet")
    return elements.Body(of.shape, of.deg, of.width_mm, of.clearance_mm)


def _disc(of: Drawing) -> disc.Body:
    if of.depth is not None:
        raise ValueError("the series is that of a sheet")
    return disc.Body(of.shape, of.deg, of.width_mm)


def _slab(of: Drawing) -> slab.Body:
    assert isinstance(of.depth, Solid)
    return slab.Body(of.shape, of.deg, of.width_mm, of.depth, of.clearance_mm)


BEYOND_SHEET = frozenset(OUTSIDE_SOLID)
BEYOND_TOUCH = frozenset(
    {
        "third-dimension",
        "domain-shape",
        "anisotropy",
        "conductivity-gradient",
        "conductivity-patch",
        "indenter-grounding",
        "smooth-dent",
        "palm",
        "slit",
        "drying-front",
        "bubble",
        "warming-patch",
        "pile-up",
    }
)
GENERATORS = {
    one.name: one
    for one in (
        Generator("boundary", _boundary, BEYOND_SHEET, 1e-5),
        Generator("elements", _elements, BEYOND_SHEET | {"third-dimension"}, 2e-4),
        Generator("disc", _disc, BEYOND_SHEET | BEYOND_TOUCH, 1e-9),
        Generator("slab", _slab, BEYOND_TOUCH, 3e-4, solid=True),
    )
}
