"""A touch of a body as what it is there: a column through the depth, in which the conductivity is
multiplied by 1 + contrast at every height.

It does not couple the cosines in depth. For the mean over the depth it is a sheet's touch; for
cos(k z), k = m pi / depth, where the potential obeys lap u = k^2 u both inside and outside, it is
the charge -contrast du/dn on its edge. Inside, u is a sum of I_l(k r) exp(i l phi) about the
touch's centre; these functions, of unit energy, are further multipoles in addition to TouchEdge's.
Without a rim, multipole l responds to itself by k a I_l'(k a) K_l(k a); its coupling to rim and
electrodes follows from the addition theorem, I_p(k r) exp(i p phi) about the body's centre in I_l
about the touch's (Abramowitz & Stegun 9.1.79). Lengths are over the body's radius.
"""

import numpy as np
from scipy.linalg import block_diag

from eitskin.physics.bessel_ratios import inner_steps, log_inner, outer_steps
from eitskin.physics.forward import Forward
from eitskin.physics.touch import TouchEdge

MOST_SHEETS = 16  # cosines in depth beyond the mean
MOST_DEGREE = 24  # multipoles of each cosine, as of the finest touch of a sheet
LEAST_OFFSET = 1e-100  # off the centre, for a touch in it: ln I_p(k r) needs r > 0


class ColumnTouch:
    """A touch's edge with its multipoles in the cosines m >= 1 of the depth, with TouchEdge's
    interface.

    coupling (n order, K): to the electrodes' modes; mass (K, K): energy of all multipoles;
    self_response (K', K'): response to themselves of those beyond TouchEdge's. tolerance: a
    multipole whose effect on the transfer between neighbouring electrodes is below this share of
    TouchEdge's is left out. A touch that the rim clips has TouchEdge's multipoles alone.
    """

    def __init__(
        self, edge: TouchEdge, to_electrodes: np.ndarray, forward: Forward, tolerance: float
    ):
        """`to_electrodes` (n order, 2 degree): coupling of the edge; `forward`: the body."""
        self.edge, self.body = edge, forward.electrodes
        radius_mm = edge.geometry.radius_mm
        self.centre, self.radius = edge.centre / radius_mm, edge.radius / radius_mm
        self.k = np.zeros(0)
        self.kept_indices: list[np.ndarray] = []
        self.coupling, self.self_response = to_electrodes, np.zeros((0, 0))
        if not edge.clipped:
            self._reach(-np.log(tolerance))
            self._couple(forward.unit_currents(), tolerance)
        self.mass = block_diag(edge.mass, np.eye(len(self.self_response)))

    def _reach(self, digits: float) -> None:
        """Choose the number of cosines in depth and the orders about the touch and about the
        body's centre."""
        body, gap = self.body, 1.0 - abs(self.centre) - self.radius
        clearance = max(body.distance(self.centre) - self.radius, gap)
        sheets = int(min(np.ceil(digits * body.depth / (2.0 * np.pi * clearance)), MOST_SHEETS))
        degree = digits / (2.0 * np.log1p(clearance / self.radius))
        self.k = np.pi / body.depth * np.arange(1, sheets + 1)
        self.degree = int(min(np.ceil(degree), MOST_DEGREE))
        self.rim_orders = int(min(np.ceil(digits / gap), body.n_max))

    def _sizes(self) -> tuple[np.ndarray, np.ndarray]:
        """(sheets, degree + 1) each: the multipoles' response without a rim; logarithm of their
        size, I_l(k a) over sqrt(2 pi) at unit energy."""
        k, log_slope = self.k * self.radius, inner_steps(self.degree, self.k * self.radius)
        inverse = np.arange(self.degree + 1)[:, None] + log_slope  # x I' / I
        free = inverse / (log_slope + outer_steps(self.degree, k))
        return free.T, (log_inner(k, log_slope) + 0.5 * np.log(inverse)).T

    def _at_rim(self, orders: int) -> np.ndarray:
        """(sheets, 2 (orders + 1), 2 (degree + 1)): the multipoles expanded in the rim's orders,
        which have unit size on the rim."""
        order, degree = np.arange(orders + 1)[:, None], np.arange(self.degree + 1)
        shift = self.k * max(abs(self.centre), LEAST_OFFSET)
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
        """Set the couplings to the electrodes' modes and the multipoles' response. currents (n
        order, n): of unit drives."""
        body, sheet_coupling = self.body, self.coupling
        turn = np.argsort(body.geometry.electrode_deg % 360.0)
        pair_currents = (currents[:, turn] - currents[:, np.roll(turn, 1)]).T
        weight, vectors = np.linalg.eigh(self.edge.mass)
        vectors = vectors[:, weight > 0] / np.sqrt(weight[weight > 0])
        sheet_change = ((pair_currents @ sheet_coupling @ vectors) ** 2).sum(axis=1).max()
        pair_currents = pair_currents.reshape(-1, body.up)
        angular = _orders(body.angular.T, self.rim_orders).T
        response, image = (np.tile(part, 2) for part in rim_responses(self.rim_orders, self.k))
        free = np.tile(self._sizes()[0], 2)
        coupling, self_responses = [sheet_coupling], []
        at_rim = self._at_rim(self.rim_orders)
        for sheet, height_modes in enumerate(np.sqrt(2.0) * body.wave(self.k).T):
            driven = (pair_currents @ height_modes).reshape(body.n, -1) @ angular * response[sheet]
            share = ((driven @ at_rim[sheet]) ** 2).max(axis=0)
            indices = np.flatnonzero(share > tolerance * sheet_change)
            modes = at_rim[sheet][:, indices]
            across = angular @ (response[sheet][:, None] * modes)
            coupling.append(
                (across[:, None] * height_modes[:, None]).reshape(len(currents), len(indices))
            )
            self_responses.append(
                (modes * image[sheet][:, None]).T @ modes + np.diag(free[sheet, indices])
            )
            self.kept_indices.append(indices)
        self.coupling, self.self_response = np.hstack(coupling), block_diag(*self_responses)

    def response_to(self, source: "ColumnTouch") -> np.ndarray:
        """(K', K' of source): response to another touch's multipoles, of those beyond
        TouchEdge's."""
        if source is self:
            return self.self_response
        orders = max(self.rim_orders, source.rim_orders)
        image = np.tile(rim_responses(orders, self.k)[1], 2)
        rim_modes, source_rim_modes = self._at_rim(orders), source._at_rim(orders)
        blocks = []
        for sheet in range(max(len(self.k), len(source.k))):
            rows, columns = self._sheet_indices(sheet), source._sheet_indices(sheet)
            block = np.zeros((len(rows), len(columns)))
            if block.size:
                a, b = rim_modes[sheet][:, rows], source_rim_modes[sheet][:, columns]
                block = (a * image[sheet][:, None]).T @ b
                block += self._direct(source, sheet)[np.ix_(rows, columns)]
            blocks.append(block)
        return block_diag(*blocks) if blocks else np.zeros((0, 0))

    def _sheet_indices(self, sheet: int) -> np.ndarray:
        return self.kept_indices[sheet] if sheet < len(self.kept_indices) else np.zeros(0, int)

    def _direct(self, source: "ColumnTouch", sheet: int) -> np.ndarray:
        """(2 (degree + 1), 2 (degree + 1) of source): response without a rim, K_l about the
        source's centre expanded in I_l about this one's."""
        degree, source_degree = np.arange(self.degree + 1)[:, None], np.arange(source.degree + 1)
        step, degree_sum = self.centre - source.centre, self.degree + source.degree
        k = self.k[sheet : sheet + 1] * abs(step)
        inner = inner_steps(degree_sum, k)
        log_outer = -np.log(inner + outer_steps(degree_sum, k)) - log_inner(k, inner)
        size = self._sizes()[1][sheet][:, None] + source._sizes()[1][sheet] + 1j * np.pi * degree
        return _real(
            *(
                np.exp(size + log_outer[np.abs(lag), 0] + 1j * np.angle(step) * lag)
                for lag in (source_degree - degree, -source_degree - degree)
            )
        )


def rim_responses(orders: int, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(K, orders + 1) each: potential at the rim of a unit current through it, q_n, and the
    rim's reflection of a field from inside, -K_n' I_n^2 / I_n'."""
    order, inner, outer = (
        np.arange(orders + 1)[:, None],
        *(steps(orders, k) for steps in (inner_steps, outer_steps)),
    )
    response = 1.0 / (order + inner)
    return response.T, (response * (outer - order) / (inner + outer)).T


def _orders(values: np.ndarray, orders: int) -> np.ndarray:
    """(2 (orders + 1), k): the lowest orders of cosine and sine coefficients (2 (n_max + 1), k)."""
    half = len(values) // 2
    return np.concatenate([values[: orders + 1], values[half : half + orders + 1]])


def _real(co_rotating: np.ndarray, counter_rotating: np.ndarray) -> np.ndarray:
    """(..., 2 P, 2 L): a real map of functions on the circle, by cosines, then sines, of orders 0
    and up.

    co_rotating (..., P, L): coefficients from exp(i l phi) to exp(i p phi); counter_rotating: from
    exp(-i l phi). The sines of order 0 are 0.
    """
    even, odd = co_rotating + counter_rotating, co_rotating - counter_rotating
    *stack, p, degree = even.shape
    real = np.empty((*stack, 2, p, 2, degree))
    real[..., 0, :, 0, :], real[..., 0, :, 1, :] = even.real, odd.imag
    real[..., 1, :, 0, :], real[..., 1, :, 1, :] = -even.imag, odd.real
    real[..., 0, 0, :, :] *= np.sqrt(0.5)
    real[..., 0, 0] *= np.sqrt(0.5)
    real[..., 1, 0, :, :] = real[..., 1, 0] = 0.0
    return real.reshape(*stack, 2 * p, 2 * degree)
