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

import numpy as np
from scipy.linalg import block_diag

from eitskin.physics.bessel_ratios import inner_steps, log_inner, outer_steps
from eitskin.physics.forward import Forward
from eitskin.physics.touch import TouchEdge

MOST_SHEETS = 16
MOST_DEGREE = 24
CENTRAL = 1e-100  # a touch in the very centre is taken to be this far off it


class ColumnTouch:
    """A touch's edge with its multipoles in the sheets m >= 1 too; what TouchEdge is to a sheet.

    coupling (n order, K): to the electrodes' modes; mass, own (K', K'): energy and response to
    themselves, of all K multipoles and of those beyond TouchEdge's. tolerance: a multipole that
    changes what neighbouring electrodes see of each other by less, as a share of TouchEdge's, is
    left out. A touch that the rim clips has TouchEdge's multipoles alone.
    """

    def __init__(
        self, edge: TouchEdge, to_electrodes: np.ndarray, forward: Forward, tolerance: float
    ):
        """`to_electrodes` (n order, 2 degree): the edge's coupling; `forward`: the body."""
        self.edge, self.body = edge, forward.electrodes
        radius_mm = edge.geometry.radius_mm
        self.centre, self.radius = edge.centre / radius_mm, edge.radius / radius_mm
        self.k = np.zeros(0)
        self.kept: list[np.ndarray] = []
        self.coupling, self.own = to_electrodes, np.zeros((0, 0))
        if not edge.clipped:
            self._reach(-np.log(tolerance))
            self._couple(forward.unit_currents(), tolerance)
        self.mass = block_diag(edge.mass, np.eye(len(self.own)))

    def _reach(self, digits: float) -> None:
        """Sheets and orders, about the touch and about the body's centre, that may matter."""
        body, gap = self.body, 1.0 - abs(self.centre) - self.radius
        apart = max(body.distance(self.centre) - self.radius, gap)
        sheets = int(min(np.ceil(digits * body.depth / (2.0 * np.pi * apart)), MOST_SHEETS))
        degree = digits / (2.0 * np.log1p(apart / self.radius))
        self.k = np.pi / body.depth * np.arange(1, sheets + 1)
        self.degree = int(min(np.ceil(degree), MOST_DEGREE))
        self.rim_orders = int(min(np.ceil(digits / gap), body.n_max))

    def _sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """(sheets, degree + 1): the multipoles' response free of rim; ln of their size, I_l(k a)
        over sqrt(2 pi) at unit energy."""
        k, own = self.k * self.radius, inner_steps(self.degree, self.k * self.radius)
        inverse = np.arange(self.degree + 1)[:, None] + own  # x I' / I
        free = inverse / (own + outer_steps(self.degree, k))
        return free.T, (log_inner(k, own) + 0.5 * np.log(inverse)).T

    def _at_rim(self, orders: int) -> np.ndarray:
        """(sheets, 2 (orders + 1), 2 (degree + 1)): the multipoles in the rim's orders, of unit
        size on the rim."""
        order, degree = np.arange(orders + 1)[:, None], np.arange(self.degree + 1)
        shift = self.k * max(abs(self.centre), CENTRAL)
        log_shift = log_inner(shift, inner_steps(orders + self.degree, shift)).T
        log_rim = log_inner(self.k, inner_steps(orders, self.k)).T
        scale = self._sizes()[1][:, None, :] - log_rim[:, :, None]
        turn = -1j * np.angle(self.centre)
        return _real(
            *(
                np.exp(turn * lag) * np.exp(log_shift[:, np.abs(lag)] + scale)
                for lag in (order - degree, order + degree)
            )
        )

    def _couple(self, currents: np.ndarray, tolerance: float) -> None:
        """Couplings to the electrodes' modes and among themselves; `currents` of unit drives."""
        body, sheet_coupling = self.body, self.coupling
        turn = np.argsort(body.geometry.electrode_deg % 360.0)
        between = (currents[:, turn] - currents[:, np.roll(turn, 1)]).T
        weight, vectors = np.linalg.eigh(self.edge.mass)
        vectors = vectors[:, weight > 0] / np.sqrt(weight[weight > 0])
        seen = ((between @ sheet_coupling @ vectors) ** 2).sum(axis=1).max()
        between = between.reshape(-1, body.up)
        angular = _orders(body.angular.T, self.rim_orders).T
        response, image = (np.tile(part, 2) for part in rim_responses(self.rim_orders, self.k))
        free = np.tile(self._sizes()[0], 2)
        coupling, own = [sheet_coupling], []
        at_rim = self._at_rim(self.rim_orders)
        for sheet, up in enumerate(np.sqrt(2.0) * body.wave(self.k).T):
            driven = (between @ up).reshape(body.n, -1) @ angular * response[sheet]
            share = ((driven @ at_rim[sheet]) ** 2).max(axis=0)
            kept = np.flatnonzero(share > tolerance * seen)
            modes = at_rim[sheet][:, kept]
            across = angular @ (response[sheet][:, None] * modes)
            coupling.append((across[:, None] * up[:, None]).reshape(len(currents), len(kept)))
            own.append((modes * image[sheet][:, None]).T @ modes + np.diag(free[sheet, kept]))
            self.kept.append(kept)
        self.coupling, self.own = np.hstack(coupling), block_diag(*own)

    def response_to(self, other: "ColumnTouch") -> np.ndarray:
        """(K', K' of other): response to another touch's multipoles, beyond TouchEdge's."""
        if other is self:
            return self.own
        orders = max(self.rim_orders, other.rim_orders)
        image = np.tile(rim_responses(orders, self.k)[1], 2)
        mine, theirs = self._at_rim(orders), other._at_rim(orders)
        blocks = []
        for sheet in range(max(len(self.k), len(other.k))):
            rows, columns = self._kept(sheet), other._kept(sheet)
            block = np.zeros((len(rows), len(columns)))
            if block.size:
                a, b = mine[sheet][:, rows], theirs[sheet][:, columns]
                block = (a * image[sheet][:, None]).T @ b
                block += self._direct(other, sheet)[np.ix_(rows, columns)]
            blocks.append(block)
        return block_diag(*blocks) if blocks else np.zeros((0, 0))

    def _kept(self, sheet: int) -> np.ndarray:
        return self.kept[sheet] if sheet < len(self.kept) else np.zeros(0, int)

    def _direct(self, other: "ColumnTouch", sheet: int) -> np.ndarray:
        """(2 (degree + 1), 2 (degree + 1) of other): free of rim, K_l about the other's centre in
        I_l about this one's."""
        mine, theirs = np.arange(self.degree + 1)[:, None], np.arange(other.degree + 1)
        step, most = self.centre - other.centre, self.degree + other.degree
        k = self.k[sheet : sheet + 1] * abs(step)
        inner = inner_steps(most, k)
        log_outer = -np.log(inner + outer_steps(most, k)) - log_inner(k, inner)
        size = self._sizes()[1][sheet][:, None] + other._sizes()[1][sheet] + 1j * np.pi * mine
        return _real(
            *(
                np.exp(size + log_outer[np.abs(lag), 0] + 1j * np.angle(step) * lag)
                for lag in (theirs - mine, -theirs - mine)
            )
        )


def rim_responses(orders: int, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K, orders + 1) each: what a unit current through the rim makes there, q_n, and what the rim
    throws back of a field from inside, -K_n' I_n^2 / I_n'."""
    order, inner, outer = (
        np.arange(orders + 1)[:, None],
        *(steps(orders, k) for steps in (inner_steps, outer_steps)),
    )
    response = 1.0 / (order + inner)
    return response.T, (response * (outer - order) / (inner + outer)).T


def _orders(values: np.ndarray, orders: int) -> np.ndarray:
    """(2 (orders + 1), k): of cosines, then sines, (2 (n_max + 1), k) the lowest orders."""
    half = len(values) // 2
    return np.concatenate([values[: orders + 1], values[half : half + orders + 1]])


def _real(same: np.ndarray, opposite: np.ndarray) -> np.ndarray:
    """(..., 2 P, 2 L): a real map of functions on the circle, by cosines, then sines, of orders 0
    and up; same (..., P, L): from exp(i l phi) to exp(i p phi), opposite: from exp(-i l phi). The
    sines of order 0 are 0."""
    even, odd = same + opposite, same - opposite
    *stack, p, degree = even.shape
    real = np.empty((*stack, 2, p, 2, degree))
    real[..., 0, :, 0, :], real[..., 0, :, 1, :] = even.real, odd.imag
    real[..., 1, :, 0, :], real[..., 1, :, 1, :] = -even.imag, odd.real
    real[..., 0, 0, :, :] *= np.sqrt(0.5)
    real[..., 0, 0] *= np.sqrt(0.5)
    real[..., 1, 0, :, :] = real[..., 1, 0] = 0.0
    return real.reshape(*stack, 2 * p, 2 * degree)
