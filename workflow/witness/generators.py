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
Maker = Callable[
    [Shape, np.ndarray, np.ndarray, Depth | Solid | None, float | None, Resolution | None], AnyBody
]

LAWS: dict[str, type[Outside]] = OUTSIDE | OUTSIDE_SOLID | UNSEEN  # outside the catalogue


@dataclass(frozen=True)
class Generator:
    """body(shape, deg, width_mm, depth, clearance_mm, resolution): as `boundary.Body`; unable: the
    laws of `strengths.DRAWN`, `outside` and `unseen` that it does not solve; least_level: the least
    noise, over the median |v|, that its cases may have: three times its own error; solid: whether
    its depth is a `slab.Solid`, whatever the laws."""

    name: str
    body: Maker
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


def _boundary(
    shape: Shape,
    deg: np.ndarray,
    width_mm: np.ndarray,
    depth: Depth | Solid | None,
    clearance_mm: float | None,
    resolution: Resolution | None,
) -> boundary.Body | DeepBody:
    if depth is None:
        return boundary.Body(shape, deg, width_mm, clearance_mm, resolution)
    assert isinstance(depth, Depth)
    return DeepBody(shape, deg, width_mm, depth, clearance_mm, resolution)


def _elements(
    shape: Shape,
    deg: np.ndarray,
    width_mm: np.ndarray,
    depth: Depth | Solid | None,
    clearance_mm: float | None,
    resolution: Resolution | None,
) -> elements.Body:
    if depth is not None:
        raise ValueError("triangles are those of a sheet")
    return elements.Body(shape, deg, width_mm, clearance_mm)


def _disc(
    shape: Shape,
    deg: np.ndarray,
    width_mm: np.ndarray,
    depth: Depth | Solid | None,
    clearance_mm: float | None,
    resolution: Resolution | None,
) -> disc.Body:
    if depth is not None:
        raise ValueError("the series is that of a sheet")
    return disc.Body(shape, deg, width_mm)


def _slab(
    shape: Shape,
    deg: np.ndarray,
    width_mm: np.ndarray,
    depth: Depth | Solid | None,
    clearance_mm: float | None,
    resolution: Resolution | None,
) -> slab.Body:
    assert isinstance(depth, Solid)
    return slab.Body(shape, deg, width_mm, depth, clearance_mm)


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
