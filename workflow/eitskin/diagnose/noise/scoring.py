"""Fisher scoring of the variances of a rig's errors: slope and expected information.

For a covariance C = N + sum_c v_c U_c U_c^T and a residual r, with g = U_c^T C^-1 r,

    d log L / d v_c = (|g|^2 - tr U_c^T C^-1 U_c) / 2,
    information_cd  = |U_c^T C^-1 U_d|^2 / 2          (Harville, JASA 72, 1977),

where norms run over all products, each over what one error acts on.
"""

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from eitskin import cores
from eitskin.diagnose.noise.components import COMPONENTS
from eitskin.diagnose.noise.low_rank import block_products, block_sums
from eitskin.diagnose.noise.rig_errors import RigErrors
from eitskin.diagnose.noise.whitening import ORDER, Whitening

CACHED_BYTES = 1 << 27  # a larger scoring is not cached: 128 MiB, of a machine's few GiB


class _Columns(NamedTuple):
    """Columns (K, N, M) of all components that act on one kind: the numbers of these, and the
    number of each one's first column."""

    acts_on: str
    members: list[int]
    starts: np.ndarray
    columns: np.ndarray


class Scoring:
    """What the scores of the variances of C components need beside a residual, at one covariance.

    information (C, C): expected. Where single precision is enough it is computed in that, and so is
    what depends on it: the direction of a step, and the width of intervals. Likelihoods, which
    decide on every step, are in double precision.
    """

    def __init__(self, rig_errors: RigErrors, whitening: Whitening, names: list[str]):
        self.whitening = whitening
        self._indicator = rig_errors.press_indicator
        columns = rig_errors.filtered
        self._unit = np.ones(len(names))  # of the variances
        single = whitening.single_precision
        if single is not whitening:
            columns = rig_errors.single_precision_columns
            self._indicator = self._indicator.astype(np.float32)
            self._unit = np.array([rig_errors.prior_sds[name] ** 2 for name in names])
        stacked = cores.threaded(
            partial(_entered_and_whitened, single, columns, names),
            [kind for kind in ORDER if any(COMPONENTS[name].acts_on == kind for name in names)],
        )
        self._kinds = [entered for entered, _ in stacked]
        whitened = [white for _, white in stacked]
        self._traces = cores.threaded(partial(_traces, single, self._indicator), whitened)
        self.information = self._information(whitened, len(names))

    def _information(self, kinds: list[_Columns], count: int) -> np.ndarray:
        """(C, C): of the variances of `count` components, of whitened columns."""
        pairs = [(a, b) for number, a in enumerate(kinds) for b in kinds[number:]]
        squares = cores.threaded(partial(_squared_products, self._indicator), pairs)
        information = np.zeros((count, count))
        for (a, b), square in zip(pairs, squares, strict=True):
            total = np.add.reduceat(square, a.starts)
            total = np.add.reduceat(total, b.starts, axis=1)
            information[np.ix_(a.members, b.members)] = 0.5 * total
            information[np.ix_(b.members, a.members)] = 0.5 * total.T
        return information / np.outer(self._unit, self._unit)

    @property
    def nbytes(self) -> int:
        """Bytes of its columns, and about those of the whitening."""
        errors = self.whitening.errors
        arrays = [] if errors is None else vars(errors).values()
        error_bytes = sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))
        return sum(kind.columns.nbytes for kind in self._kinds) + 2 * error_bytes

    def slope(self, residual: np.ndarray) -> np.ndarray:
        """(C,): derivative of the log likelihood of a residual (N, M) by the variances."""
        white = self.whitening(residual)

        def excess(number: int) -> np.ndarray:
            """(K,): squared products of columns with the residual, above their mean."""
            kind = self._kinds[number]
            conjugate = white
            if kind.acts_on != "whole":
                conjugate = self.whitening.conjugate(white, kind.acts_on)
            products = kind.columns * conjugate.astype(kind.columns.dtype)
            sums = block_sums(products, kind.acts_on, self._indicator)
            sums = (sums[:, None] if kind.acts_on == "whole" else sums).astype(float)
            return (sums**2).sum(axis=1) - self._traces[number]

        slope = np.zeros(len(self.information))
        excesses = cores.threaded(excess, range(len(self._kinds)))
        for kind, column_excess in zip(self._kinds, excesses, strict=True):
            slope[kind.members] = 0.5 * np.add.reduceat(column_excess, kind.starts)
        return slope / self._unit


class ScoringCache:
    """The scoring at the sds from which learning last began or at which it ended: many fits begin
    at one, and the next round of one fit where its last round ended."""

    def __init__(self) -> None:
        self._latest: tuple[RigErrors, dict[str, float], list[str], Scoring] | None = None

    def scoring(
        self, rig_errors: RigErrors, error_sds: dict[str, float], names: list[str]
    ) -> Scoring:
        """The scoring of some components of a rig at their sds, computed where it is not cached."""
        if self._latest is not None:
            cached_rig, cached_sds, cached_names, scoring = self._latest
            if cached_rig is rig_errors and cached_sds == error_sds and cached_names == names:
                return scoring
            self.clear()
        scoring = Scoring(rig_errors, rig_errors.whitening(error_sds, restricted=True), names)
        self.store(rig_errors, error_sds, names, scoring)
        return scoring

    def prepare(self, rig_errors: RigErrors, start_sds: Mapping[str, float]) -> None:
        """Computes the scoring with which learning begins at a start."""
        if names := rig_errors.learned_first(start_sds):
            self.scoring(rig_errors, rig_errors.initial_sds(start_sds), names)

    def clear(self) -> None:
        """Frees the memory of the scoring."""
        self._latest = None

    def store(
        self,
        rig_errors: RigErrors,
        error_sds: Mapping[str, float],
        names: list[str],
        scoring: Scoring,
    ) -> None:
        """Caches a scoring in place of any other, unless it is larger than CACHED_BYTES."""
        self.clear()
        if scoring.nbytes < CACHED_BYTES:
            self._latest = rig_errors, dict(error_sds), list(names), scoring


def _entered_and_whitened(
    whitening: Whitening, columns: Mapping[str, np.ndarray], names: list[str], acts_on: str
) -> tuple[_Columns, _Columns]:
    """Columns of the components among `names` that act on one kind: those whose products with a
    residual are the scores, and whitened by all that acts on the same; columns (K, N, M):
    filtered, by name."""
    members = [i for i, name in enumerate(names) if COMPONENTS[name].acts_on == acts_on]
    counts = [len(columns[names[i]]) for i in members]
    stacked = np.concatenate([columns[names[i]] for i in members])
    entered = whitening.entered(stacked, acts_on)
    white = entered
    for factor in whitening.factors:
        if factor.acts_on == acts_on or acts_on == "whole":
            white = factor.apply(white, factor.inverse_root)
    whitened = _Columns(acts_on, members, np.cumsum([0, *counts[:-1]]), white)
    return whitened if acts_on == "whole" else whitened._replace(columns=entered), whitened


def _traces(whitening: Whitening, indicator: np.ndarray, kind: _Columns) -> np.ndarray:
    """(K,): squared lengths of whitened columns less what the factors take out of them that are
    applied after those of their own kind; indicator (B, N): of presses."""
    square = kind.columns**2
    total = square.sum(axis=(1, 2))
    for factor in whitening.factors:
        if ORDER.index(factor.acts_on) <= ORDER.index(kind.acts_on):
            continue
        loss = -factor.inverse
        if factor.acts_on != "channel":
            products = block_products(kind.columns, factor.directions, kind.acts_on, indicator)
            products = products**2
            if factor.acts_on == "press":
                products = np.tensordot(indicator, products, axes=1)
            total -= (products * loss[:, None]).sum(axis=(0, 2))
        elif kind.acts_on == "frame":
            # A frame's error and a channel's share one reading.
            share = np.einsum("knm,mk->nm", factor.directions**2, loss)
            total -= np.einsum("jnm,nm->j", square, share)
        else:
            for k, direction in enumerate(factor.directions):
                products = kind.columns * direction
                sums = np.einsum("bn,jnm->jbm", indicator, products, optimize=True)
                total -= np.einsum("jbm,m->j", sums**2, loss[:, k])
    return total


def _squared_products(indicator: np.ndarray, pair: tuple[_Columns, _Columns]) -> np.ndarray:
    """(J, K): squared products, summed, of whitened columns a (J, N, M) and b (K, N, M) of a pair
    of kinds, a of one that is taken out no later than b; indicator (B, N): of presses."""
    a, b = pair
    if a.acts_on == b.acts_on or b.acts_on != "channel":
        products = block_products(a.columns, b.columns, a.acts_on, indicator)
        return (products.astype(float) ** 2).sum(axis=0)
    if a.acts_on == "frame":
        # A frame's error and a channel's share one reading.
        a_square, b_square = ((kind.columns**2).reshape(len(kind.columns), -1) for kind in pair)
        return a_square @ b_square.T
    squares = []
    for column in a.columns:
        sums = np.einsum("bn,knm->kbm", indicator, column * b.columns, optimize=True)
        squares.append((sums**2).sum(axis=(1, 2)))
    return np.array(squares)
