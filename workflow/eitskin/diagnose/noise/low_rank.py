"""Square roots of I + U U^T and of its inverse, for columns U of few directions.

As in Woodbury's identity (1950) only the K x K matrices U^T U of the columns are decomposed: with
U^T U = V diag(l) V^T and orthonormal directions E = U V l^(-1/2),

    (I + U U^T)^p = I + E (diag((1 + l)^p) - I) E^T,    p = -1, -1/2 or 1/2.
"""

from collections.abc import Callable
from copy import copy
from functools import cached_property

import numpy as np

BATCH_COLUMNS = 8  # worked on at once: more take memory, fewer read the directions more often
NEGLIGIBLE = 1e-9  # squared length in noise units of a direction that is none: rounding


def in_batches(
    function: Callable[[np.ndarray], np.ndarray], values: np.ndarray, map_function: Callable
) -> np.ndarray:
    """(..., N, M): a function of (V, N, M) of BATCH_COLUMNS values at a time, one by one or by
    another `map_function`: columns of errors are read once for all of a batch."""
    flat = values.reshape(-1, *values.shape[-2:])
    batches = [flat[start : start + BATCH_COLUMNS] for start in range(0, len(flat), BATCH_COLUMNS)]
    products = list(map_function(function, batches))
    if len(products) == 1:
        return products[0].reshape(values.shape)
    return np.concatenate(products or [flat]).reshape(values.shape)


def press_indicator(press_label: np.ndarray) -> np.ndarray:
    """(B, N): 1 where a frame is of a press, else 0, the presses in ascending order; press_label
    (N,): of each frame, -1 for none."""
    return (np.unique(press_label[press_label >= 0])[:, None] == press_label).astype(float)


def block_products(
    a: np.ndarray, b: np.ndarray, acts_on: str, indicator: np.ndarray | None = None
) -> np.ndarray:
    """(B, J, K): sums of the products of columns a (J, N, M) and b (K, N, M) over each of the B
    frames, presses or channels, or over the whole, that one error acts on; indicator (B, N): of
    presses."""
    if acts_on == "whole":
        return (a.reshape(len(a), -1) @ b.reshape(len(b), -1).T)[None]
    if acts_on == "channel":
        a, b = (np.ascontiguousarray(columns.transpose(2, 0, 1)) for columns in (a, b))
        return a @ b.transpose(0, 2, 1)
    products = a.transpose(1, 0, 2) @ b.transpose(1, 2, 0)
    if acts_on != "press":
        return products
    return (indicator @ products.reshape(len(products), -1)).reshape(-1, len(a), len(b))


def block_sums(products: np.ndarray, acts_on: str, indicator: np.ndarray) -> np.ndarray:
    """(K, ...): sums of products (K, N, M) over what one error acts on, as in `block_products`."""
    if acts_on == "whole":
        return products.sum(axis=(1, 2))
    if acts_on == "channel":
        return products.sum(axis=1)
    rows = products.sum(axis=2)
    return rows if acts_on == "frame" else rows @ indicator.T


class LowRankFactor:
    """Powers of I + U U^T for columns U (K, N, M) of independent errors of every channel, frame or
    press, or of the whole: B blocks that share no reading, of K directions each.

    acts_on: "channel", "frame", "press" or "whole"; press_label (N,): of each frame, for presses.
    eigenvalues (B, K): of U^T U. directions (K, N, M): orthonormal within each block.
    """

    def __init__(self, columns: np.ndarray, acts_on: str, press_label: np.ndarray | None = None):
        self.acts_on, self.shape = acts_on, columns.shape[1:]
        self.indicator = None if press_label is None else press_indicator(press_label)
        gram = block_products(columns, columns, acts_on, self.indicator)
        eigenvalues, eigenvectors = np.linalg.eigh(gram)
        self.eigenvalues = np.maximum(eigenvalues, 0.0)
        scale = np.where(self.eigenvalues > 0.0, self.eigenvalues, 1.0) ** -0.5
        self.directions = self._combined(columns, eigenvectors * scale[:, None, :])

    def _combined(self, columns: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """(J, N, M): sums of columns (K, N, M) with coefficients (B, K, J)."""
        if self.acts_on == "whole":
            sums = coefficients[0].T @ columns.reshape(len(columns), -1)
            return sums.reshape(-1, *self.shape)
        if self.acts_on == "channel":
            sums = (columns.transpose(2, 1, 0) @ coefficients).transpose(2, 1, 0)
            return np.ascontiguousarray(sums)
        if self.acts_on == "press":
            assert self.indicator is not None
            coefficients = np.tensordot(self.indicator.T, coefficients, axes=1)
        return np.ascontiguousarray((columns.transpose(1, 2, 0) @ coefficients).transpose(2, 0, 1))

    def _projections(self, values: np.ndarray) -> np.ndarray:
        """(B, V, K): products of values (V, N, M) with the directions."""
        if self.acts_on == "whole":
            flat = self.directions.reshape(len(self.directions), -1)
            return (values.reshape(len(values), -1) @ flat.T)[None]
        if self.acts_on == "channel":
            products = [np.einsum("nm,knm->km", value, self.directions) for value in values]
            return np.array(products).transpose(2, 0, 1)
        rows = values.transpose(1, 0, 2) @ self.directions.transpose(1, 2, 0)
        if self.acts_on != "press":
            return rows
        assert self.indicator is not None
        return np.tensordot(self.indicator, rows, axes=1)

    def _expanded(self, amplitudes: np.ndarray) -> np.ndarray:
        """(V, N, M): the directions with amplitudes (B, V, K), summed."""
        if self.acts_on == "whole":
            flat = self.directions.reshape(len(self.directions), -1)
            return (amplitudes[0] @ flat).reshape(-1, *self.shape)
        if self.acts_on == "channel":
            by_value = np.ascontiguousarray(amplitudes.transpose(1, 2, 0))
            sums = np.empty((len(by_value), *self.shape), np.result_type(by_value, self.directions))
            for channel_amplitudes, total in zip(by_value, sums, strict=True):
                np.einsum("km,knm->nm", channel_amplitudes, self.directions, out=total)
            return sums
        if self.acts_on == "press":
            assert self.indicator is not None
            amplitudes = np.tensordot(self.indicator.T, amplitudes, axes=1)
        return (amplitudes @ self.directions.transpose(1, 0, 2)).transpose(1, 0, 2)

    def apply(self, values: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """(..., N, M): (I + E diag(gain) E^T) times values; gain (B, K): `inverse_root`, `inverse`
        or `root`."""

        def product(batch: np.ndarray) -> np.ndarray:
            total = self._expanded(self._projections(batch) * gain[:, None])
            total += batch
            return total

        return in_batches(product, values, map)

    @property
    def single_precision(self) -> "LowRankFactor":
        """The same in single precision."""
        single = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                vars(single)[name] = value.astype(np.float32)
        return single

    @cached_property
    def inverse_root(self) -> np.ndarray:
        """(B, K): gain of the power -1/2."""
        return 1.0 / np.sqrt(1.0 + self.eigenvalues) - 1.0

    @cached_property
    def inverse(self) -> np.ndarray:
        """(B, K): gain of the power -1."""
        return -self.eigenvalues / (1.0 + self.eigenvalues)

    @cached_property
    def root(self) -> np.ndarray:
        """(B, K): gain of the power 1/2."""
        return np.sqrt(1.0 + self.eigenvalues) - 1.0

    @cached_property
    def log_determinant(self) -> float:
        """Of I + U U^T."""
        return float(np.log1p(self.eigenvalues).sum())


class ProjectionFactor(LowRankFactor):
    """The limit of LowRankFactor for infinitely large columns: takes their directions out for good.

    `root` leaves them out, for what is taken out does not come back.
    """

    def __init__(self, columns: np.ndarray, acts_on: str):
        super().__init__(columns, acts_on)
        shape = self.eigenvalues.shape
        self.eigenvalues = np.full(shape, np.inf)
        self.inverse = self.inverse_root = np.full(shape, -1.0)
        self.root = np.zeros(shape)


class LinkedFactor(LowRankFactor):
    """LowRankFactor of columns P F C: errors C (L, N, M) of every channel, independent from channel
    to channel, that the factors F of frames and P of presses, applied before, have carried into
    other channels."""

    def __init__(self, columns: np.ndarray, carriers: list[LowRankFactor]):
        self.acts_on, self.shape, self.carriers = "linked", columns.shape[1:], carriers
        self.columns = columns
        eigenvalues, eigenvectors = np.linalg.eigh(self._gram())
        positive = eigenvalues > NEGLIGIBLE
        self.eigenvalues = eigenvalues[None, positive]
        self.coefficients = eigenvectors[:, positive] / np.sqrt(eigenvalues[positive])

    def _gram(self) -> np.ndarray:
        """(LM, LM): (P F C)^T P F C, by the directions of frames and of presses."""
        count, width = len(self.columns), self.shape[1]
        diagonal = np.zeros((count, width, count, width))
        channel = np.arange(width)
        diagonal[:, channel, :, channel] = np.einsum("knm,lnm->mkl", self.columns, self.columns)
        gram = diagonal.reshape(count * width, -1)
        for number, carrier in enumerate(self.carriers):
            directions = carrier.directions
            for earlier in reversed(self.carriers[:number]):
                directions = earlier.apply(directions, earlier.inverse_root)
            products = self.columns[:, None] * directions
            if carrier.acts_on == "press":
                products = carrier.indicator @ products
            # (LM, K, B), B frames or presses.
            products = products.transpose(0, 3, 1, 2)
            products = products.reshape(count * width, len(directions), -1)
            gram += np.einsum("ckb,bk,dkb->cd", products, carrier.inverse, products, optimize=True)
        return gram

    def apply(self, values: np.ndarray, gain: np.ndarray) -> np.ndarray:
        """(..., N, M): (I + E diag(gain) E^T) times values; gain (1, K)."""
        flat = values.reshape(-1, *self.shape)
        carried = flat
        for carrier in reversed(self.carriers):
            carried = carrier.apply(carried, carrier.inverse_root)
        products = np.einsum("lnm,vnm->vlm", self.columns, carried)
        amplitudes = products.reshape(len(flat), len(self.coefficients))
        amplitudes = ((amplitudes @ self.coefficients) * gain[0]) @ self.coefficients.T
        change = np.einsum("lnm,vlm->vnm", self.columns, amplitudes.reshape(products.shape))
        for carrier in self.carriers:
            change = carrier.apply(change, carrier.inverse_root)
        return values + change.reshape(values.shape)
