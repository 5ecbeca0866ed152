"""Curves of a drawing, and the loops that they join to."""

import re
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

ELECTRODE_NAME = re.compile(r"electrodes?(?:[ _-]?\d+)?")
RIM_NAME = re.compile(r"rim|outline|skin")
JOINT_SHARE = 1e-4  # of the extent: ends nearer than that meet
CURVE_POINTS = 129  # of a drawn arc or spline


@dataclass(frozen=True, eq=False)
class Curve:
    """Pieces one behind the other, complex x + i y with y upwards, in units of the drawing: two
    points (2,) of a straight piece, (K,) of a bent one, (1,) of a mark without extent.

    names: of the shape, its group, class or layer, in small letters; place: what a message calls
    it.
    """

    pieces: tuple[np.ndarray, ...]
    names: frozenset[str]
    place: str

    @cached_property
    def points(self) -> np.ndarray:
        """(N,): all points in order; where pieces meet, one."""
        return np.concatenate([self.pieces[0], *(piece[1:] for piece in self.pieces[1:])])

    @property
    def straight(self) -> bool:
        """Whether every piece is straight."""
        return all(len(piece) == 2 for piece in self.pieces)

    @property
    def gap(self) -> float:
        """Distance between its ends."""
        return float(abs(self.points[-1] - self.points[0]))

    @property
    def extent(self) -> np.ndarray:
        """(2,): width and height of the box around it."""
        return np.array([np.ptp(self.points.real), np.ptp(self.points.imag)])

    @property
    def closed(self) -> bool:
        """Whether its ends meet."""
        return len(self.points) > 2 and self.gap <= JOINT_SHARE * float(self.extent.max())

    @property
    def middle(self) -> complex:
        """Middle of the box around it."""
        x, y = self.points.real, self.points.imag
        return complex(0.5 * (x.min() + x.max()), 0.5 * (y.min() + y.max()))

    @property
    def is_electrode(self) -> bool:
        """Whether a name says that it is an electrode."""
        return any(map(ELECTRODE_NAME.fullmatch, self.names))

    @property
    def is_rim(self) -> bool:
        """Whether a name says that it is the rim."""
        return any(map(RIM_NAME.fullmatch, self.names))

    def backwards(self) -> "Curve":
        """The same curve from its end to its start."""
        return replace(self, pieces=tuple(piece[::-1] for piece in self.pieces[::-1]))

    def shifted(self, step: complex) -> "Curve":
        """Moved by a step."""
        return replace(self, pieces=tuple(piece + step for piece in self.pieces))

    def scaled(self, factor: float, mirrored: bool) -> "Curve":
        """Times a factor, and with -x for x if `mirrored`."""
        pieces = (factor * (-piece.conj() if mirrored else piece) for piece in self.pieces)
        return replace(self, pieces=tuple(pieces))


@dataclass(frozen=True)
class Drawing:
    """Curves in the file's order; unit_mm: how long a unit is, None where the file does not say."""

    curves: tuple[Curve, ...]
    unit_mm: float | None


def joined(curves: list[Curve]) -> list[Curve]:
    """Curves in order, where open ones with a common end are one: it stands where its first part
    stood."""
    if not curves:
        return []
    points = np.concatenate([curve.points for curve in curves])
    reach = JOINT_SHARE * float(max(np.ptp(points.real), np.ptp(points.imag)))
    chains = []
    waiting = list(curves)
    while waiting:
        chain = waiting.pop(0)
        while not chain.closed:
            longer = _longer(chain, waiting, reach)
            if longer is None:
                break
            chain = longer
        chains.append(chain)
    return chains


def _longer(chain: Curve, waiting: list[Curve], reach: float) -> Curve | None:
    """The chain with one of the waiting open curves at one of its ends; that one is taken out."""
    for turned in (chain, chain.backwards()):
        for index, curve in enumerate(waiting):
            if curve.closed or len(curve.points) < 2 or len(chain.points) < 2:
                continue
            for following in (curve, curve.backwards()):
                if abs(following.points[0] - turned.points[-1]) <= reach:
                    del waiting[index]
                    names = chain.names | curve.names
                    return replace(chain, pieces=turned.pieces + following.pieces, names=names)
    return None
