"""A round skin as a body: electrodes over part of its height, touches through its full height.

Cosines in depth decompose the body into sheets, u_n cos(n pi z / D), coupled only by the
electrodes' faces. Sheet n obeys lap u = k^2 u, k = n pi / D; its Neumann function on the disc is a
series of Bessel functions added to the free K0(k r) / 2 pi. The current density under a face is
represented on nodes in arc and height; elsewhere only its moments in the first sheets enter
(Vauhkonen et al. 1999 for the model; Abramowitz, Stegun 9.6 for the functions).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.linalg import block_diag, lu_factor, lu_solve
from scipy.special import ive, k0, kve

from witness.arc import lagrange, panel_nodes, segment_operator, segment_panels
from witness.boundary import Body, Disc, Place, Radial, Resolution, levelled
from witness.curves import Shape

HALVINGS = 7  # of an arc's panels: fewer than for a sheet, as the face's nodes multiply
ARC_NODES = 8  # Gauss nodes of a panel
LEVELS = 30  # dyadic panels towards a logarithm, down to rounding
FADE = 8.0  # sheets count elsewhere until they decay on the way there and back by exp(-FADE)


@dataclass(frozen=True)
class Depth:
    """depth_mm of the body; the electrodes' height and the height of their centres, mm.

    nodes: in height on a face; reach: sheets a face is resolved in, times depth over height.
    """

    depth_mm: float
    height_mm: float
    z_mm: float
    nodes: int = 24
    reach: float = 14.0

    def face(self) -> tuple[np.ndarray, np.ndarray]:
        """Heights and weights, mm, dense towards the face's ends."""
        x, w = leggauss(self.nodes)
        half = 0.5 * self.height_mm
        return (
            self.z_mm + half * np.sin(0.5 * np.pi * x),
            half * 0.5 * np.pi * np.cos(0.5 * np.pi * x) * w,
        )

    def unresolved(self) -> np.ndarray:
        """(nodes, nodes): the potential on the face, times a conductance, of densities on it, by
        the unresolved sheets, for which the arc is straight: 1 / k each.

        sum 2 cos n a cos n b / n is -log|4 sin((a - b) / 2) sin((a + b) / 2)|.
        """
        z, weight = self.face()
        x = leggauss(self.nodes)[0]
        steps = 2.0 * 0.5 ** np.arange(LEVELS)
        angle = np.pi * z / self.depth_mm
        total = np.zeros((self.nodes, self.nodes))
        for row, place in enumerate(x):
            cuts = np.concatenate([place + steps, place - steps, -1 + steps, 1 - steps, [place]])
            cuts = np.unique(cuts[(cuts >= -1.0) & (cuts <= 1.0)])
            points, w = (v.ravel() for v in panel_nodes(cuts, 12))
            half = 0.5 * self.height_mm
            w = w * half * 0.5 * np.pi * np.cos(0.5 * np.pi * points)
            point_angle = np.pi * (self.z_mm + half * np.sin(0.5 * np.pi * points)) / self.depth_mm
            sines = np.sin(0.5 * (point_angle - angle[row])) * np.sin(
                0.5 * (point_angle + angle[row])
            )
            kernel = -np.log(np.maximum(np.abs(4.0 * sines), 1e-300))
            total[row] = (w * kernel) @ lagrange(points, self.nodes)
        n = np.arange(1, self.sheets)
        waves = np.cos(np.outer(angle, n))
        return (total - 2.0 * (waves / n) @ waves.T * weight) / np.pi

    @property
    def full(self) -> bool:
        """Whether the electrodes cover the full height."""
        return self.height_mm >= self.depth_mm * (1.0 - 1e-12)

    @property
    def sheets(self) -> int:
        """The number of sheets that resolve a face."""
        return 1 if self.full else int(np.ceil(self.reach * self.depth_mm / self.height_mm))


def _ratios(x: np.ndarray, max_order: int) -> np.ndarray:
    """(len(x), max_order + 1): I_(m + 1)(x) / I_m(x), by backward recurrence."""
    start = max_order + 60 + int(2.0 * x.max())
    ratio = np.zeros(len(x))
    ratios = np.empty((len(x), max_order + 1))
    for m in range(start, -1, -1):
        ratio = x / (2.0 * (m + 1) + x * ratio)
        if m <= max_order:
            ratios[:, m] = ratio
    return ratios


class Waves:
    """Bessel functions of one sheet on the unit disc, orders 0 to `max_order`."""

    def __init__(self, k: float, max_order: int):
        self.k, self.m = k, np.arange(max_order + 1)
        ratio = _ratios(np.array([k]), max_order)[0]
        self.log_derivative = ratio + self.m / k  # I_m' / I_m at the rim
        self.flux = 1.0 / (k * self.log_derivative)  # potential for a unit flux at the rim
        self._ratio = ratio
        log_k = np.empty(max_order + 1)  # log of K_m I_m at the rim, by Wronskian: 1 / (x (r + q))
        q = kve(1, k) / kve(0, k)
        for m in range(max_order + 1):
            log_k[m] = -np.log(k * (ratio[m] + q))
            q = 1.0 / q + 2.0 * (m + 1) / k
        self.product = np.exp(log_k)  # I_m K_m
        # -K' / I' = (I K) (K_(m + 1) / K_m - m / k) / I^2 / own, less the 1 / I^2
        upper = 1.0 / (k * self.product) - ratio  # K_(m + 1) / K_m
        self.image = self.product * (upper - self.m / k) / self.log_derivative

    def inside(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(len(r), orders): I_m(k r) / I_m(k) and its derivative by r."""
        x = self.k * r
        ratio_at_r = _ratios(x, len(self.m) - 1)
        order_zero = ive(0, x) / ive(0, self.k) * np.exp(x - self.k)
        steps = np.cumsum(np.log(ratio_at_r[:, :-1]) - np.log(self._ratio[:-1]), axis=1)
        value = order_zero[:, None] * np.exp(np.hstack([np.zeros((len(r), 1)), steps]))
        return value, value * (self.k * ratio_at_r + self.m / r[:, None])


def _even(m: np.ndarray) -> np.ndarray:
    return np.where(m == 0, 1.0, 2.0)


class Face:
    """The current under one electrode's face: moments in the first sheets for outer potentials.

    half_arc: in radii; order: Gauss nodes along the arc; far: the number of sheets that reach other
    electrodes.
    """

    def __init__(self, half_arc: float, radius_mm: float, depth: Depth, order: int, far: int):
        t, w = (v.ravel() for v in panel_nodes(segment_panels(HALVINGS), ARC_NODES))
        self.local, self.weight = lagrange(t, order), w
        z, z_weight = depth.face()
        n = np.arange(depth.sheets)
        wave = np.cos(np.pi * np.outer(z, n) / depth.depth_mm)
        depth_weights = wave.T * z_weight * _even(n)[:, None] / depth.depth_mm
        size = len(t), len(z)
        system = np.zeros((*size, *size))
        for sheet, operator in enumerate(self._operators(t, half_arc, radius_mm, depth)):
            system += (
                operator[:, None, :, None]
                * np.outer(wave[:, sheet], depth_weights[sheet])[None, :, None]
            )
        if depth.sheets > 1:
            node_index = np.arange(len(t))
            system[node_index, :, node_index] += depth.unresolved() / (half_arc * radius_mm)
        self.system = system.reshape(np.prod(size), np.prod(size))
        shape = (np.prod(size), order * far)
        self.spread = np.einsum("ij,zn->iznj", self.local, wave[:, :far]).reshape(shape)
        moment_weights = np.einsum("i,ij,nz->iznj", w, self.local, depth_weights[:far])
        self.taken = moment_weights.reshape(shape)

    @staticmethod
    def _operators(
        t: np.ndarray, half_arc: float, radius_mm: float, depth: Depth
    ) -> Iterator[np.ndarray]:
        """For every sheet the potential at the nodes t of densities there, per unit of the half
        arc; for the first sheet only the log kernel of the segment."""
        yield segment_operator(HALVINGS, ARC_NODES)[2]
        if depth.sheets == 1:
            return
        lag, weight, local = _resolved(t)
        chord = 2.0 * np.sin(0.5 * half_arc * lag)
        distances = half_arc * np.abs(t[:, None] - t)
        for sheet in range(1, depth.sheets):
            k = sheet * np.pi * radius_mm / depth.depth_mm
            free = np.einsum("iq,iqj->ij", weight * k0(k * chord), local) / np.pi
            waves = Waves(k, int(max(400, 6.0 * k)))
            smooth_coefficients = (
                _even(waves.m) * (waves.flux - 2.0 * waves.product) / (2.0 * np.pi)
            )
            lags = np.linspace(0.0, 2.0 * half_arc, 257)
            smooth = np.polynomial.Chebyshev.fit(
                lags, np.cos(np.outer(lags, waves.m)) @ smooth_coefficients, 60
            )
            yield (
                free
                + smooth(distances) * panel_nodes(segment_panels(HALVINGS), ARC_NODES)[1].ravel()
            )

    def response(self, beta: float) -> np.ndarray:
        """(far order, far order): moments, sheet by sheet, for values of the outer potential at
        the Gauss nodes in each."""
        matrix = self.system.copy()
        matrix[np.diag_indices(len(matrix))] += beta
        return self.taken.T @ np.linalg.solve(matrix, self.spread)


def _resolved(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lags, weights (N, Q) and interpolation (N, Q, N) of dyadic panels towards every node t."""
    ends = segment_panels(HALVINGS)
    rows = []
    for place in t:
        steps = 2.0 * 0.5 ** np.arange(LEVELS)
        lags = np.concatenate([ends - place, steps, -steps, [0.0]])
        lags = np.unique(lags[(lags >= -1.0 - place) & (lags <= 1.0 - place)])
        lag, weight = (v.ravel() for v in panel_nodes(lags, ARC_NODES))
        panel = np.clip(np.searchsorted(ends, place + lag) - 1, 0, len(ends) - 2)
        inner = (2.0 * (place + lag) - ends[panel] - ends[panel + 1]) / np.diff(ends)[panel]
        local = np.zeros((len(lag), len(t)))
        columns = panel[:, None] * ARC_NODES + np.arange(ARC_NODES)
        np.put_along_axis(local, columns, lagrange(np.clip(inner, -1, 1), ARC_NODES), axis=1)
        rows.append((np.abs(lag), weight, local))
    max_count = max(len(lag) for lag, _, _ in rows)
    lag, weight = np.ones((len(t), max_count)), np.zeros((len(t), max_count))
    local = np.zeros((len(t), max_count, len(t)))
    for i, (a, b, c) in enumerate(rows):
        lag[i, : len(a)], weight[i, : len(a)], local[i, : len(a)] = a, b, c
    return lag, weight, local


class DeepBody:
    """`boundary.Body` in three dimensions. Raises ValueError for a rim that is not round, or a
    conductivity with direction or tilt."""

    def __init__(
        self,
        shape: Shape,
        deg: np.ndarray,
        width_mm: np.ndarray,
        depth: Depth,
        clearance_mm: float | None = None,
        resolution: Resolution | None = None,
    ):
        if any(shape.harmonics.values()) or shape.anisotropy[0] != 1.0 or shape.tilt:
            raise ValueError("a body needs a round rim and a conductivity without direction")
        self.flat = Body(shape, deg, width_mm, clearance_mm, resolution)
        self.shape, self.depth, self.n = shape, depth, self.flat.n
        order = self.flat.order
        start = np.sort(np.radians(deg) % (2 * np.pi))
        pitch = np.diff(np.append(start, start[0] + 2 * np.pi)).min()
        electrode_gap = (pitch - 2.0 * self.flat.half_arc.max()) * shape.radius_mm
        gap = min(0.5 * electrode_gap, np.inf if clearance_mm is None else clearance_mm)
        sheet_count = 1 + int(np.ceil(FADE * depth.depth_mm / (2.0 * np.pi * gap)))
        self.far = min(sheet_count, depth.sheets)
        self.order = order
        self.waves = [
            Waves(sheet * np.pi * shape.radius_mm / depth.depth_mm, 500)
            for sheet in range(1, self.far)
        ]
        self.faces = {
            half: Face(half, shape.radius_mm, depth, order, self.far)
            for half in np.unique(self.flat.half_arc).tolist()
        }

    @cached_property
    def mutual(self) -> list[np.ndarray]:
        """The potential at the electrodes' nodes of the others' moments, in every far sheet."""
        n, p, angle = self.n, self.order, self.flat.arc_angle
        sheets = [self.flat.among_arcs]
        lag = angle[:, None] - angle
        for waves in self.waves:
            smooth_coefficients = (
                _even(waves.m) * (waves.flux - 2.0 * waves.product) / (2.0 * np.pi)
            )
            chord = np.abs(2.0 * np.sin(0.5 * lag))
            np.fill_diagonal(chord, 1.0)
            value = k0(waves.k * chord) / np.pi
            value += (np.cos(np.outer(angle, waves.m)) * smooth_coefficients) @ np.cos(
                np.outer(angle, waves.m)
            ).T
            value += (np.sin(np.outer(angle, waves.m)) * smooth_coefficients) @ np.sin(
                np.outer(angle, waves.m)
            ).T
            blocks = value.reshape(n, p, n, p)
            blocks[range(n), :, range(n)] = 0.0
            sheets.append(value)
        return sheets

    def contact(self, length: np.ndarray) -> "DeepContact":
        """The contacts closed: length (n,) = z sigma, in radii."""
        return DeepContact(self, np.asarray(length, float))

    def place(self, discs: Sequence[Disc]) -> "DeepPlace":
        """One touch, or none. Raises ValueError for more."""
        return DeepPlace(self, tuple(discs))


class DeepContact:
    """The response of the electrodes, as `boundary.Contact`; unknowns are ordered by sheet,
    electrode, node."""

    def __init__(self, body: DeepBody, length: np.ndarray):
        n, p, far = body.n, body.order, body.far
        solved: dict = {}
        blocks = []
        for half, z in zip(body.flat.half_arc.tolist(), length.tolist(), strict=True):
            if (half, z) not in solved:
                solved[half, z] = body.faces[half].response(z / half)
            blocks.append(solved[half, z].reshape(far, p, far, p))
        response_matrix: np.ndarray = np.zeros((far, n, p, far, n, p))
        response_matrix[:, range(n), :, :, range(n)] = np.array(blocks)
        response_matrix = response_matrix.reshape(far * n * p, far * n * p)
        size = n * p
        coupled = np.hstack(
            [
                response_matrix[:, s * size : (s + 1) * size] @ among
                for s, among in enumerate(body.mutual)
            ]
        )
        self.response = lu_solve(lu_factor(np.eye(len(response_matrix)) + coupled), response_matrix)


class DeepPlace:
    """As `boundary.Place`, with one touch in every far sheet."""

    def __init__(self, body: DeepBody, discs: tuple[Disc, ...]):
        if len(discs) > 1:
            raise ValueError("one touch on a body")
        self.body, self.flat = body, Place(body.flat, discs)
        self._cached: tuple | None = None

    @cached_property
    def parts(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """`Place.fluxes` of every far sheet."""
        edge, angle = self.flat.edges[0], self.body.flat.arc_angle
        size, radius = len(edge.place), self.flat.discs[0].radius_mm / self.body.shape.radius_mm
        wave = np.minimum(np.arange(size), size - np.arange(size))
        turn = (np.arange(size)[:, None] - np.arange(size)) % size
        r, theta = np.abs(edge.place), np.angle(edge.place)
        outward = edge.normal * np.exp(-1j * theta)
        sheet_fluxes = [self.flat.fluxes]
        for waves in self.body.waves:
            m = waves.m
            value, slope = waves.inside(r)
            phase = np.exp(1j * np.outer(theta, m))
            field = value * phase
            normal = (
                slope * outward.real[:, None] + 1j * value * m * (outward.imag / r)[:, None]
            ) * phase
            weight = _even(m) / (2.0 * np.pi)
            image = ((normal * (weight * waves.image)) @ field.conj().T).real
            edge_waves = Waves(waves.k * radius, size // 2)
            # The layer's flux, mean of both sides: x (I' K + I K') / 2 = x I K I' / I - 1 / 2.
            mean = edge_waves.k * edge_waves.product * edge_waves.log_derivative - 0.5
            circulant = np.fft.ifft(mean[wave]).real[turn]
            rim = np.exp(1j * np.outer(angle, m))
            from_moments = ((normal * (weight * waves.flux)) @ rim.conj().T).real
            to_electrodes = ((rim * (weight * waves.flux)) @ field.conj().T).real * edge.weight
            sheet_fluxes.append((circulant + image * edge.weight, from_moments, to_electrodes))
        return sheet_fluxes

    def _untouched_system(self, contact: DeepContact) -> tuple[np.ndarray, ...]:
        """The parts that are independent of the contrast, cached for the latest contact: moments
        (., n + 1) of an untouched body, moments from edges, the edges' system and right-hand sides.
        """
        if self._cached is None or self._cached[0] is not contact:
            body = self.body
            n, p, size = body.n, body.order, body.n * body.order
            unit = np.zeros((len(contact.response), n + 1))
            unit[np.arange(size), np.repeat(np.arange(n), p)] = 1.0
            unit[:size, n] = -1.0
            moments = contact.response @ unit
            sheets = [slice(s * size, (s + 1) * size) for s in range(body.far)]
            pairs = list(zip(sheets, self.parts, strict=True)) if self.flat.discs else []
            response_to_edges = system = rows = None
            if pairs:
                response_to_edges = np.hstack(
                    [contact.response[:, s] @ to_electrodes for s, (_, _, to_electrodes) in pairs]
                )
                system = np.vstack(
                    [-from_moments @ response_to_edges[s] for s, (_, from_moments, _) in pairs]
                )
                rows = np.vstack([from_moments @ moments[s] for s, (_, from_moments, _) in pairs])
                system += block_diag(*(among for _, (among, _, _) in pairs))
            self._cached = contact, moments, response_to_edges, system, rows
        return self._cached[1:]

    def admittance(
        self, contact: DeepContact, contrast: Sequence[float], radial: Radial | None = None
    ) -> np.ndarray:
        """(n, n): as `Place.admittance`, in units of the conductance of the whole depth. Raises
        ValueError for a touch that is not sharp."""
        if radial is not None:
            raise ValueError("a body needs sharp touches")
        n, p = self.body.n, self.body.order
        moments, response_to_edges, system, rows = self._untouched_system(contact)
        if any(contrast):
            system = system.copy()
            system[np.diag_indices(len(system))] += 1.0 / contrast[0] + 0.5
            moments = moments + response_to_edges @ np.linalg.solve(system, rows)
        current = moments[: n * p].reshape(n, p, n + 1).sum(axis=1)
        return levelled(current, np.zeros(n + 1))
