"""The solvers of a skin, with one interface (`boundary.Body`), and the laws that each supports."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from witness import boundary, disc, elements, outline_skin, slab
from witness.boundary import Resolution
from witness.curves import OutlineShape, Shape
from witness.deep import DeepBody, Depth
from witness.outside import OUTSIDE, OUTSIDE_SOLID, Outside
from witness.slab import Solid
from witness.strengths import DRAWN
from witness.unseen import UNSEEN

AnyBody = boundary.Body | DeepBody | elements.Body | disc.Body | slab.Body

LAWS: dict[str, type[Outside]] = OUTSIDE | OUTSIDE_SOLID | UNSEEN  # outside the catalogue


@dataclass(frozen=True)
class Drawing:
    """The arguments of a body: those of `boundary.Body`, and the depth."""

    shape: Shape
    deg: np.ndarray
    width_mm: np.ndarray
    depth: Depth | Solid | None
    clearance_mm: float | None
    resolution: Resolution | None


@dataclass(frozen=True)
class Generator:
    """A solver. body: makes a body of its drawing; unable: the laws of `strengths.DRAWN`, `outside`
    and `unseen` that it cannot solve; least_level: the least noise of its cases, over the median
    |v|, three times its numerical error; solid: whether its depth is always a `slab.Solid`.
    """

    name: str
    body: Callable[[Drawing], AnyBody]
    unable: frozenset[str]
    least_level: float
    solid: bool = False

    def does(self, law: str) -> bool:
        """Whether it can solve a law."""
        return law in {*DRAWN, *LAWS} and law not in self.unable

    def can(self, kind: str) -> bool:
        """Whether `cases.draw` can draw a kind with it: null, pair, triple, single:<name> or
        outside:<law>."""
        word, _, name = kind.partition(":")
        if word in ("single", "outside"):
            return self.does(name)
        return kind in ("null", "pair", "triple")


def _boundary(drawing: Drawing) -> boundary.Body | DeepBody:
    accuracy = drawing.clearance_mm, drawing.resolution
    if drawing.depth is None:
        return boundary.Body(drawing.shape, drawing.deg, drawing.width_mm, *accuracy)
    assert isinstance(drawing.depth, Depth)
    return DeepBody(drawing.shape, drawing.deg, drawing.width_mm, drawing.depth, *accuracy)


def _elements(drawing: Drawing) -> elements.Body:
    if drawing.depth is not None:
        raise ValueError("triangles are those of a sheet")
    shape, electrodes = drawing.shape, (drawing.deg, drawing.width_mm)
    if isinstance(shape, OutlineShape):
        return outline_skin.Body(shape, *electrodes, drawing.clearance_mm)
    return elements.Body(shape, *electrodes, drawing.clearance_mm)


def _disc(drawing: Drawing) -> disc.Body:
    if drawing.depth is not None:
        raise ValueError("the series is that of a sheet")
    return disc.Body(drawing.shape, drawing.deg, drawing.width_mm)


def _slab(drawing: Drawing) -> slab.Body:
    assert isinstance(drawing.depth, Solid)
    return slab.Body(
        drawing.shape, drawing.deg, drawing.width_mm, drawing.depth, drawing.clearance_mm
    )


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
    generator.name: generator
    for generator in (
        Generator("boundary", _boundary, BEYOND_SHEET, 1e-5),
        Generator("elements", _elements, BEYOND_SHEET | {"third-dimension"}, 2e-4),
        Generator("disc", _disc, BEYOND_SHEET | BEYOND_TOUCH, 1e-9),
        Generator("slab", _slab, BEYOND_TOUCH, 3e-4, solid=True),
    )
}
