"""A touch of a body as what it is there: a column through the depth, in which the conductivity is
multiplied by 1 + contrast at every height.

It keeps the cosines in depth apart. To the mean over the depth it is a sheet's touch; to cos(k z),
k = m pi / depth, where the potential obeys lap u = k^2 u inside and outside alike, it is the charge
-contrast du/dn on its edge. Inside, u is a sum of I_l(k r) exp(i l phi) about the touch's centre;
those, of unit energy, are further multipoles beside TouchEdge's. Free of rim, multipole l responds
to itself by k a I_l'(k a) K_l(k a); rim and electrodes meet it by the addition theorem, I_p(k r)
exp(i p phi) about the body's centre in I_l about the touch's (Abramowitz & Stegun 9.1.79). Lengths
over the body's radius.
"""

from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from eitskin.cylinder import inner_steps, log_inner, outer_steps
from eitskin.touch import TouchEdge

MOST_SHEETS = 16
MOST_DEGREE = 24
CENTRAL = 1e-100  # a touch in the very centre is taken to be this far off it


class ColumnTouch:
    """A touch's edge with its multipoles in the sheets m >= 1 too; what TouchEdge is to a sheet.

    Raises nothing of its own. A touch that the rim clips has none: it keeps TouchEdge's alone.
    tolerance: share of the touch's power that a multipole may have and be left out.
    """

    def __init__(self, edge: TouchEdge, to_electrodes: np.ndarray, body, tolerance: float):
        """`to_electrodes` (n order, 2 degree): the edge's coupling; `body`: its BodyElectrodes."""
        self.edge = edge
        geometry = edge.geometry
        self.centre, self.radius = edge.centre / geometry.radius_mm, edge.radius / geometry.radius_mm
        sheets = 0
        if not edge.clipped:
            gap = 1.0 - abs(self.centre) - self.radius
            apart = max(body.distance(self.centre) - self.radius, gap)
            digits = -np.log(tolerance)
            sheets = int(min(np.ceil(digits * body.depth / (2.0 * np.pi * apart)), MOST_SHEETS))
            degree = digits / (2.0 * np.log1p(apart / self.radius))
            self.degree = int(min(np.ceil(degree), MOST_DEGREE))
            self.rim_orders = int(min(np.ceil(digits / gap), body.n_max))
        self.k = np.pi / body.depth * np.arange(1, sheets + 1)
        self.coupling = to_electrodes
        self.kept: list[np.ndarray] = []
        if sheets:
            self._expand()
            self._couple(body, tolerance)

    def _expand(self) -> None:
        """The free poles, and the multipoles' share in every order of the rim."""
        k, orders = self.k, self.rim_orders
        own = inner_steps(self.degree, k * self.radius)
        inverse = np.arange(self.degree + 1)[:, None] + own  # x I' / I
        self.free = (inverse / (own + outer_steps(self.degree, k * self.radius))).T
        # Of a multipole of unit energy, over sqrt(2 pi).
        self.log_size = (log_inner(k * self.radius, own) + 0.5 * np.log(inverse)).T
        rim, order = inner_steps(orders, k), np.arange(orders + 1)
        outer = outer_steps(orders, k)
        response = 1.0 / (order[:, None] + rim)
        image = response * (outer - order[:, None]) / (rim + outer)
        self.response, self.image = np.tile(response.T, 2), np.tile(image.T, 2)
        shift = k * max(abs(self.centre), CENTRAL)
        log_shift = log_inner(shift, inner_steps(orders + self.degree, shift)).T
        scale = self.log_size[:, None, :] - log_inner(k, rim).T[:, :, None]
        turn = np.exp(-1j * np.angle(self.centre) * np.arange(orders + self.degree + 1))
        lag = order[:, None] - np.arange(self.degree + 1)
        same = np.where(lag >= 0, turn[np.abs(lag)], turn[np.abs(lag)].conj())
        same = same * np.exp(log_shift[:, np.abs(lag)] + scale)
        lag = order[:, None] + np.arange(self.degree + 1)
        self.at_rim = _real(same, turn[lag] * np.exp(log_shift[:, lag] + scale))

    def _couple(self, body, tolerance: float) -> None:
        """Couplings to the electrodes' modes; multipoles without power dropped."""
        edge, coupling = self.edge, [self.coupling]
        power = np.trace(np.linalg.pinv(edge.mass, hermitian=True) @ coupling[0].T @ coupling[0])
        angular = body.angular.reshape(len(body.angular), 2, -1)[:, :, : self.rim_orders + 1]
        angular = angular.reshape(len(angular), -1)
        wave = np.sqrt(2.0) * body.wave(self.k)
        for sheet, up in enumerate(wave.T):
            across = angular @ (self.response[sheet][:, None] * self.at_rim[sheet])
            share = (across**2).sum(axis=0) * (up @ up)
            kept = np.flatnonzero(share > tolerance * power)
            self.kept.append(kept)
            columns = across[:, None, kept] * up[:, None]
            coupling.append(columns.reshape(len(self.coupling), len(kept)))
        self.coupling = np.hstack(coupling)

    @cached_property
    def mass(self) -> np.ndarray:
        """(K, K): the multipoles' energy; 1 beyond TouchEdge's."""
        return block_diag(self.edge.mass, np.eye(sum(len(kept) for kept in self.kept)))

    def deep_response(self, other: "ColumnTouch") -> np.ndarray:
        """(multipoles, multipoles of other): response in the sheets m >= 1 alone."""
        blocks = []
        orders = min(self.rim_orders, other.rim_orders) + 1 if self.kept and other.kept else 0
        for sheet in range(max(len(self.kept), len(other.kept))):
            mine, theirs = _kept(self, sheet), _kept(other, sheet)
            if not (len(mine) and len(theirs)):
                blocks.append(np.zeros((len(mine), len(theirs))))
                continue
            a, b = (_orders(t.at_rim[sheet], orders)[:, c] for t, c in ((self, mine), (other, theirs)))
            block = (a * _orders(self.image[sheet], orders)[:, None]).T @ b
            if self is other:
                block[np.diag_indices(len(mine))] += np.tile(self.free[sheet], 2)[mine]
            else:
                block += self._direct(other, sheet)[np.ix_(mine, theirs)]
            blocks.append(block)
        return block_diag(*blocks) if blocks else np.zeros((0, 0))

    def _direct(self, other: "ColumnTouch", sheet: int) -> np.ndarray:
        """(2 orders, 2 orders of other): response free of rim, K_l about the other's centre in I_l
        about this one's."""
        mine, theirs = np.arange(self.degree + 1)[:, None], np.arange(other.degree + 1)
        step, k = self.centre - other.centre, self.k[sheet : sheet + 1]
        most = self.degree + other.degree
        inner, outer = inner_steps(most, k * abs(step)), outer_steps(most, k * abs(step))
        log_outer = (-np.log(inner + outer) - log_inner(k * abs(step), inner))[:, 0]
        size = self.log_size[sheet][:, None] + other.log_size[sheet]
        turn, sign = np.angle(step), (-1.0) ** mine
        parts = []
        for order in (theirs, -theirs):
            lag = order - mine
            parts.append(sign * np.exp(size + log_outer[np.abs(lag)] + 1j * turn * lag))
        return _real(*parts)


def _kept(touch: ColumnTouch, sheet: int) -> np.ndarray:
    return touch.kept[sheet] if sheet < len(touch.kept) else np.zeros(0, int)


def _orders(values: np.ndarray, orders: int) -> np.ndarray:
    """Cosines and sines, along the first axis, of the lowest orders alone."""
    return values.reshape(2, -1, *values.shape[1:])[:, :orders].reshape(-1, *values.shape[1:])


def _real(same: np.ndarray, opposite: np.ndarray) -> np.ndarray:
    """(..., 2 P, 2 L): a map from orders -l, l to -p, p on the unit cosines, then sines, p = 0 ...
    and l = 0 ...; same (..., P, L): from l to p, opposite: from -l to p. The sines of order 0 are
    0."""
    same, opposite = same.copy(), opposite.copy()
    for part in (same, opposite):
        part[..., 0, :] /= np.sqrt(2.0)
        part[..., :, 0] /= np.sqrt(2.0)
    even, odd = same + opposite, same - opposite
    sines = -even.imag, odd.real
    upper = np.concatenate([even.real, odd.imag], axis=-1)
    lower = np.concatenate(sines, axis=-1)
    lower[..., 0, :] = 0.0
    upper[..., :, odd.shape[-1]] = lower[..., :, odd.shape[-1]] = 0.0
    return np.concatenate([upper, lower], axis=-2)
