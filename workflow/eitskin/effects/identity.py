"""Identities: other causes of the same readings, each stated by the effect that it is about."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin


@dataclass(frozen=True)
class Substitute:
    """An effect of the catalogue by its name, at values that follow from those of another.

    sites (S,), kind, values: as of a `Setting`.
    """

    name: str
    values: dict[str, Any] = field(default_factory=dict)
    sites: np.ndarray | None = None
    kind: str | None = None


class NamedEffect(Protocol):
    """One effect that an explanation of a recording names, as an identity sees it.

    Simulations are of the fit in which it was named: N frames, M channels, n electrodes. Methods
    that simulate raise InputError where the physics has no such skin.
    """

    @property
    def name(self) -> str:
        """Name of the effect."""

    @property
    def scope(self) -> str:
        """Whether it is sparse, dense or common."""

    @property
    def kind(self) -> str | None:
        """Kind of its sites."""

    @property
    def sites(self) -> tuple[int, ...]:
        """Its sites."""

    @property
    def values(self) -> dict[str, Any]:
        """Its parameters as fitted."""

    @property
    def skin(self) -> Skin:
        """The skin as calibrated, without effects."""

    @property
    def geometry(self) -> Geometry:
        """The skin with all effects, untouched, at the start."""

    @property
    def electrodes(self) -> np.ndarray:
        """(n,): numbers of the electrodes."""

    @property
    def channels(self) -> np.ndarray:
        """(M, 4): source, sink, plus and minus of every channel."""

    @property
    def time_s(self) -> np.ndarray:
        """(N,): times of the frames."""

    @property
    def force_N(self) -> np.ndarray:
        """(N,): forces as reported."""

    def interval(self, key: str) -> tuple[float, float]:
        """90 % interval of a parameter."""

    def partners(self, names: Sequence[str]) -> Sequence["NamedEffect"]:
        """Effects of other names, of these, beside it."""

    def simulated(
        self,
        substitutes: Sequence[Substitute] = (),
        omitted: Sequence[str] = (),
        conductivity_ratio: float | None = None,
        force_N: np.ndarray | None = None,
    ) -> np.ndarray:
        """(N, M): readings with substitutes in its place and in place of the effects that are
        omitted, with the conductivity times a ratio, and with other forces (N,)."""

    def gap(self, voltage: np.ndarray, electrodes_follow: bool = False) -> float:
        """Length, in noise units, of what readings (N, M) have beyond those of the fit, to first
        order, when calibrations and the other effects follow; electrodes_follow: or all that is
        fitted and the place of every electrode."""

    def fitted_substitute(self, name: str, displacement: complex) -> tuple[dict[str, Any], float]:
        """Parameters of another effect, without sites and with `polar` parameters, fitted in its
        place; and the gap that remains to it and to its own other sides.

        displacement: where the fit starts, as of the polar parameters: the size (its logarithm
        where it stays above 0) times exp(i m angle).
        """

    def is_distinct(self, gap: float) -> bool:
        """Whether causes with such a gap are distinguishable."""

    def equality_gap(self, partner: "NamedEffect", order: Sequence[int]) -> float:
        """Mahalanobis distance of its coordinates from those of a partner, in this order."""

    def gap_without(
        self, partner: "NamedEffect", names: Sequence[str], electrodes: Sequence[int]
    ) -> float:
        """Length, in noise units, of what it and a partner change together beyond effects with
        these names, free at each of some electrodes; to first order."""


@dataclass(frozen=True)
class OtherSide:
    """The other cause at the values that follow from a named effect: its gap to what was read, and
    a sentence on what an owner checks, "" for none."""

    gap: float
    sentence: str


@dataclass(frozen=True)
class Identity:
    """Another cause of the readings of an effect.

    names: of the catalogue that together are this cause, none where it has no name; other_side:
    computes it for a named effect, None where the identity does not speak of that one; of_pair:
    whether it needs a second effect beside the first.
    """

    names: tuple[str, ...]
    other_side: Callable[[NamedEffect], OtherSide | None]
    of_pair: bool = False
