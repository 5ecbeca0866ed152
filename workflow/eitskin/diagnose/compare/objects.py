"""Objects in the later recording: discs that conduct otherwise than the skin of the control.

The change by a disc is simulated in full (metal and air are no small changes) on an even sheet with
point electrodes at the angles of the recording, and carried over to the rig as a share of each
reading: (v1 - v0) / v0 = (u1 - u0) / u0, v measured, u simulated. So what an electrode, an
amplifier or the depth of a tank does to a reading leaves the share as it is, to first order; what
depth does to the change itself stays an error. Where a simulated reading is next to nothing, the
share is of the overall scale instead. Boards that add one voltage to all readings spoil such
shares, so the search is tried without and with a common offset, and the one that explains more with
one object is taken.

The rivals of objects, beside the faults of the instrument, are shifts of all electrodes and a
conductivity that rises across the skin: to first order, on the same sheet.

Ratio and radius hardly tell from one another where an object is small or the ratio large: ratio r
and radius a act through a² (r - 1) / (r + 1) (Seagar et al. 1987). Constants were set on the tanks
of docs/concealed/objects.md and on the development block of docs/concealed/pairs.md.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import comb, log
from typing import Any

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from eitskin.diagnose.compare.discs import (
    FREE,
    Disc,
    bounds,
    coordinates_of,
    derivatives_at,
    discs_at,
    halves,
    overlapping,
)
from eitskin.diagnose.compare.evidence import Evidence, Explanation
from eitskin.diagnose.compare.faults import Signature
from eitskin.diagnose.compare.sheet import RINGS, Sheet
from eitskin.diagnose.compare.wander import Wander
from eitskin.errors import InputError
from eitskin.physics.protocol import tied_channels

NAME, KIND = "conductivity-patch", "places"
MOST_OBJECTS = 4
LEAST_GRID_SHARE = 0.1  # of the change's square, that a disc of the grid must explain to be a start
LEAST_SHARE = 0.05  # of the change's square, that one more object must explain
LEAST_EXPLAINED = 0.75  # of the change's square beyond noise, by objects that are named
STARTS = 2  # of each sign, for the first object; one for more
WIDE = 0.3  # radius of a disc that may be two
NEIGHBOURHOOD = 0.2  # starts closer than this are one
MOST_EVALUATIONS = 40  # of a fit: each is a forward solve
TOLERANCE = 1e-4  # of the cost, that one more step of a fit must bring: a nat needs no more
INTERIOR = 1e-3  # by which a start is moved inside its bounds, as `least_squares` asks
OVERLAP_COST = 1e3  # times the residual, where discs overlap: the fit turns back
FOLDS = 5
SINGULAR = 1e-6  # of the largest singular value: a column below it is rounding


@dataclass(frozen=True)
class Objects(Signature):
    """The change by discs together, as a signature; coordinates (4 k,): of the discs."""

    discs: tuple[Disc, ...] = ()
    coordinates: np.ndarray = field(default_factory=lambda: np.zeros(0))


def objects_of(explanation: Explanation) -> Objects:
    """The objects by which a change is explained."""
    signature = explanation.signatures[0]
    assert isinstance(signature, Objects)
    return signature


class ObjectSearch:
    """Objects sought in the residual of one change.

    evidence: of the change, beside what named signatures explain; offset: whether a common
    offset of the control's readings is subtracted from them. Values of channels that the sheet does
    not simulate are free.
    """

    def __init__(
        self,
        sheet: Sheet,
        evidence: Evidence,
        named_signatures: Sequence[Signature],
        offset: bool = False,
    ):
        self.sheet, self.evidence, self.named_signatures = sheet, evidence, named_signatures
        wander = evidence.wander
        self.gain = sheet.gain(wander.mean, wander.usable, offset)
        unsimulated = wander.usable & ~sheet.simulated
        self.free = np.eye(len(unsimulated))[:, unsimulated]
        white = wander.whitened(self.free)
        length = np.sqrt((white**2).sum(axis=0))
        self._free_basis = np.linalg.qr(white[:, length > 0])[0]
        self.residual = self._projected(evidence.residual)
        self._whitened_grid: np.ndarray | None = None
        self.square = float(self.residual @ self.residual)

    def _projected(self, white: np.ndarray) -> np.ndarray:
        """Whitened values (M,) or (M, k) across what is explained already and what is free."""
        basis = self.evidence.basis
        white = white - basis @ (basis.T @ white)
        return white - self._free_basis @ (self._free_basis.T @ white)

    def _whitened(self, changes: np.ndarray) -> np.ndarray:
        """Simulated changes (M,) or (M, k) in the space of the residual."""
        gain = self.gain if changes.ndim == 1 else self.gain[:, None]
        return self._projected(self.evidence.wander.whitened(gain * changes))

    @cached_property
    def single_fit(self) -> OptimizeResult | None:
        """The best fit with one object; None where no disc of the grid explains enough."""
        return self._fit_with_one_more(np.zeros(0))

    def single(self) -> Explanation:
        """The best explanation with one object."""
        return self._explanation(self.single_fit)

    def best(self) -> Explanation:
        """The best explanation with as many objects as bring enough."""
        best: Any = self.single_fit
        while len(best.x) < FREE * MOST_OBJECTS:
            wider = self._fit_with_one_more(best.x)
            if wider is None or best.cost - wider.cost < 0.5 * LEAST_SHARE * self.square:
                break
            if self._explanation(wider).evidence < self._explanation(best).evidence:
                break
            best = wider
        return self._explanation(best)

    def _fit_with_one_more(self, coordinates: np.ndarray) -> OptimizeResult | None:
        """The best fit with one object beside those at coordinates (4 k,), or with one of these
        split in two."""
        fits = []
        for i, disc in enumerate(discs_at(coordinates)):
            if disc.radius < WIDE:
                continue
            unsplit = np.delete(coordinates.reshape(-1, FREE), i, axis=0).ravel()
            for pair in halves(disc):
                if not overlapping([*discs_at(unsplit), *pair]):
                    start = np.concatenate([unsplit, *(coordinates_of(half) for half in pair)])
                    fits.append(self._fit(start, self.residual, self._whitened))
        for conducting in (True, False):
            for disc in self._starts(coordinates, conducting):
                start = np.append(coordinates, coordinates_of(disc))
                fits.append(self._fit(start, self.residual, self._whitened))
        return min(fits, key=lambda fit: fit.cost, default=None)

    def _starts(self, coordinates: np.ndarray, conducting: bool) -> Iterator[Disc]:
        """Discs of the grid, of one sign and clear of those at coordinates (4 k,), that explain
        most of the residual of these, at some distance from one another."""
        placed = discs_at(coordinates)
        residual = self.residual - (self._whitened(self.sheet.change(placed)) if placed else 0.0)
        discs, changes = self.sheet.grid
        if self._whitened_grid is None:
            self._whitened_grid = self._whitened(changes)
        gains = 2.0 * residual @ self._whitened_grid - (self._whitened_grid**2).sum(axis=0)
        starts: list[Disc] = []
        for i in np.argsort(-gains):
            disc = discs[i]
            count = 1 if placed else STARTS
            if gains[i] < (0.0 if placed else LEAST_GRID_SHARE * self.square):
                return
            if len(starts) == count:
                return
            if disc.conducting is not conducting or overlapping([*placed, disc]):
                continue
            if all(np.hypot(disc.x - d.x, disc.y - d.y) > NEIGHBOURHOOD for d in starts):
                starts.append(disc)
                yield disc

    def _fit(
        self,
        start: np.ndarray,
        residual: np.ndarray,
        whitened: Callable[[np.ndarray], np.ndarray],
    ) -> OptimizeResult:
        """Least squares of a residual from a start (4 k,), each disc of the sign of its start.

        whitened: maps simulated changes to the space of the residual.
        """
        overlap = np.full(len(residual), OVERLAP_COST * (np.linalg.norm(residual) + 1.0))

        def misfit(coordinates: np.ndarray) -> np.ndarray:
            discs = discs_at(coordinates)
            if overlapping(discs):
                return overlap
            try:
                return residual - whitened(self.sheet.change(discs))
            except InputError:
                return overlap

        def jacobian(coordinates: np.ndarray) -> np.ndarray:
            derivatives = self.sheet.derivatives(discs_at(coordinates))
            return -whitened(derivatives @ derivatives_at(coordinates))

        low, high = bounds(start)
        inside = np.clip(start, low + INTERIOR, high - INTERIOR)
        limits = {"ftol": TOLERANCE, "xtol": TOLERANCE, "max_nfev": MOST_EVALUATIONS}
        return least_squares(misfit, inside, jacobian, (low, high), x_scale="jac", **limits)

    def _explanation(self, fit: OptimizeResult) -> Explanation:
        """A fit as an explanation, with its evidence."""
        discs = tuple(discs_at(fit.x))
        change = self.gain * self.sheet.change(discs)
        signature = Objects(NAME, KIND, tuple(range(len(discs))), self.free, change, discs, fit.x)
        explanation = self.evidence.explanation([signature], [signature])
        places = sum(count for _, count in RINGS)
        penalty = 0.5 * FREE * len(discs) * log(self.evidence.dof)
        penalty += log(comb(places, len(discs)))
        return replace(explanation, evidence=explanation.evidence - penalty)

    def opposite_sign(self, explanation: Explanation) -> Explanation | None:
        """The best explanation with the sign of one object reversed."""
        objects = objects_of(explanation)
        coordinates = objects.coordinates.reshape(-1, FREE)
        fits = []
        for i, disc in enumerate(objects.discs):
            unchanged = np.delete(coordinates, i, axis=0).ravel()
            starts = list(self._starts(unchanged, not disc.conducting))
            starts.append(replace(disc, ratio=1.0 / disc.ratio))
            for start in starts:
                fits.append(
                    self._fit(
                        np.append(unchanged, coordinates_of(start)), self.residual, self._whitened
                    )
                )
        best = min(fits, key=lambda fit: fit.cost, default=None)
        return None if best is None else self._explanation(best)

    def skin_rivals(self) -> list[Explanation]:
        """Explanations by other changes of the skin."""
        rivals = []
        for name, columns in self.sheet.tangents.items():
            basis = np.column_stack([self.gain[:, None] * columns, self.free])
            signature = Signature(name, KIND, (), basis)
            rivals.append(self.evidence.explanation([signature], [signature]))
        return rivals

    def explained_share(self, explanation: Explanation) -> float:
        """The share of the change's square beyond noise that objects explain."""
        shift = explanation.signatures[0].shift
        assert shift is not None
        residual = self.residual - self._projected(self.evidence.wander.whitened(shift))
        noise = float(self.evidence.wander.dof) if self.evidence.wander.prior_dof else 0.0
        square = max(self.square - noise, 0.0)
        return 1.0 - max(float(residual @ residual) - noise, 0.0) / square if square > 0 else 0.0

    def coordinate_sd(self, explanation: Explanation) -> np.ndarray:
        """Standard deviations (4 k,) of the discs' coordinates, by the residual of their fit."""
        coordinates = objects_of(explanation).coordinates
        discs = discs_at(coordinates)
        jacobian = self._whitened(self.sheet.derivatives(discs) @ derivatives_at(coordinates))
        residual = self.residual - self._whitened(self.sheet.change(discs))
        dof = max(self.evidence.wander.dof - len(coordinates), 1)
        square = float(residual @ residual)
        return np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian)) * square / dof)

    def held_out(self, explanation: Explanation) -> dict:
        """The misfit of reciprocal pairs held out, without the objects and with them, in units of
        the wander.

        The objects are fitted to the other pairs; what a skin does without a fault is fitted beside
        them.
        """
        wander, start = self.evidence.wander, objects_of(explanation).coordinates
        change = wander.change - sum(s.shift for s in self.named_signatures if s.shift is not None)
        scale = np.where(wander.usable, wander.scale, 0.0)
        nuisance = np.column_stack(
            [scale[:, None] * wander.nuisance, *(s.basis for s in self.named_signatures), self.free]
        )
        label = tied_channels(self.sheet.channels)[0]
        pairs = np.unique(label[wander.usable])
        np.random.default_rng(0).shuffle(pairs)
        square, count = np.zeros(2), 0
        for fold in np.array_split(pairs, FOLDS):
            held_out_mask = np.isin(label, fold) & wander.usable
            training = _TrainingChannels(nuisance, wander, wander.usable & ~held_out_mask)

            def whitened(changes: np.ndarray, training: _TrainingChannels = training) -> np.ndarray:
                return training.whitened((self.gain * changes.T).T)

            fit = self._fit(start, training.whitened(change), whitened)
            predicted = self.gain * self.sheet.change(discs_at(fit.x))
            for i, prediction in enumerate((0.0, predicted)):
                misfit = training.misfit(change - prediction, held_out_mask)
                square[i] += float(misfit @ misfit)
            count += int(held_out_mask.sum())
        rms_without, rms_with = np.sqrt(square / max(count, 1)).tolist()
        return {
            "pairs": len(pairs),
            "folds": FOLDS,
            "rms_before": rms_without,
            "rms_after": rms_with,
        }


def object_search(
    sheet: Sheet, evidence: Evidence, named_signatures: Sequence[Signature]
) -> ObjectSearch | None:
    """The search, without or with a common offset, that explains more with one object; None where
    an object explains next to nothing."""
    offsets = (False, True) if sheet.signed else (False,)
    searches = [ObjectSearch(sheet, evidence, named_signatures, offset) for offset in offsets]
    costs = [
        (search, search.single_fit.cost) for search in searches if search.single_fit is not None
    ]
    return min(costs, key=lambda pair: pair[1], default=(None, 0.0))[0]


class _TrainingChannels:
    """The channels of a mask (M,) bool, and the nuisance (M, k), V, fitted to them."""

    def __init__(self, nuisance: np.ndarray, wander: Wander, mask: np.ndarray):
        self.mask, self.scale = mask, wander.scale
        inverse_scale = np.where(np.isfinite(wander.scale), 1.0 / wander.scale, 0.0)
        self.nuisance = inverse_scale[:, None] * nuisance
        left_vectors, singular_values, right_vectors = np.linalg.svd(
            self.nuisance[mask], full_matrices=False
        )
        largest = max(singular_values.max(initial=0.0), np.finfo(float).tiny)
        regular = singular_values > SINGULAR * largest
        self.basis = left_vectors[:, regular]
        self.inverse = (right_vectors[regular].T / singular_values[regular]) @ self.basis.T

    def whitened(self, values: np.ndarray) -> np.ndarray:
        """Values (M,) or (M, k), V, of these channels, in units of scale, across the nuisance."""
        white = (values.T / self.scale).T[self.mask]
        return white - self.basis @ (self.basis.T @ white)

    def misfit(self, values: np.ndarray, held_out_mask: np.ndarray) -> np.ndarray:
        """Values (M,), V, of held-out channels, in units of scale, less the nuisance as fitted to
        these channels."""
        white = values / self.scale
        return white[held_out_mask] - self.nuisance[held_out_mask] @ (
            self.inverse @ white[self.mask]
        )
