"""A cache of touched places: how a touch there couples to the skin, for any contrast."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np

CACHE_BYTES = 1 << 26  # 64 MiB; the oldest responses are dropped first

Place = tuple[float, float, float]


@dataclass(frozen=True)
class TouchCoupling:
    """A touch's multipoles: mass and response to themselves (K, K), and coupling (n order, K) to
    the electrodes' modes."""

    mass: np.ndarray
    response: np.ndarray
    coupling: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        return self.mass.nbytes + self.response.nbytes + self.coupling.nbytes


@dataclass(frozen=True)
class ContactCoupling:
    """A unit current that enters evenly over a touch: the potential it makes at the electrodes'
    modes (n order,) and at the touch's multipoles (K,), its power, and the share of the power
    that is spent inside the touch."""

    to_electrodes: np.ndarray
    to_touch: np.ndarray
    power: float
    inner_power: float

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        return self.to_electrodes.nbytes + self.to_touch.nbytes


class Sized(Protocol):
    """An object that knows how many bytes it takes."""

    @property
    def nbytes(self) -> int: ...


Response = TypeVar("Response", bound=Sized)


class TouchCache:
    """Responses of places (x_mm, y_mm, radius_mm) by kind, as many of the latest as fit in
    CACHE_BYTES."""

    def __init__(self) -> None:
        self._responses: dict[tuple[type, Place], Any] = {}
        self._nbytes = 0

    def __contains__(self, place: Place) -> bool:
        return (TouchCoupling, place) in self._responses

    def get(
        self,
        kind: type[Response],
        place: Place,
        compute: Callable[[], Response],
        serves: Callable[[Response], bool] = lambda response: True,
    ) -> Response:
        """The cached response of a kind at a place if it `serves`; else the result of `compute`,
        which is cached where it serves."""
        key = kind, place
        if key in self._responses and serves(self._responses[key]):
            return self._responses[key]
        response = compute()
        if serves(response):
            if key in self._responses:
                self._nbytes -= self._responses.pop(key).nbytes
            self._nbytes += response.nbytes
            while self._responses and self._nbytes > CACHE_BYTES:
                self._nbytes -= self._responses.pop(next(iter(self._responses))).nbytes
            self._responses[key] = response
        return response
