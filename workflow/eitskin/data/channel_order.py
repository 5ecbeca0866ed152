"""Whether readings are in the order of their channel table.

A passive linear skin reads the same with drive and measurement exchanged (reciprocity). Where no
channel has its reciprocal in the table, two weaker identities remain: exchanging source and sink
changes the sign and nothing else (any skin), and rotating drive and measurement by one electrode
changes little (an even skin). A wrong table breaks them clearly.
"""

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eitskin.errors import InputError
from eitskin.physics.protocol import reciprocal_channels

MIN_RECIPROCAL_SHARE = 0.25  # of channels in pairs: fewer do not show an order
NOISE_MARGIN = 1.1  # times the noise's power: its estimate from some dozen frames may be too small
MIN_SIGNAL_SHARE = 0.25  # of the noise's power: below it, what noise leaves is no misfit


@dataclass(frozen=True)
class Misfit:
    """Misfits of readings to the identities of their channel table: rms, relative to the readings.

    `overall` is the reciprocity where the table has pairs, else the rms of reversal and rotation.
    """

    reciprocity: float | None
    reversal: float | None
    rotation: float | None

    @property
    def overall(self) -> float | None:
        """The overall misfit; None where the table has none of the identities."""
        if self.reciprocity is not None:
            return self.reciprocity
        weaker = [value for value in (self.reversal, self.rotation) if value is not None]
        return float(np.sqrt(np.mean(np.square(weaker)))) if weaker else None


def misfit(
    readings: np.ndarray,
    channels: np.ndarray,
    n_electrodes: int,
    signed: bool,
    variance: np.ndarray | None = None,
) -> Misfit:
    """Misfit of K frames of readings (K, M) to channels (M, 4); NaN is skipped.

    Rotation compares the channels' rms over frames, so that touches off the centre average out.
    `signed` is False for magnitudes; `variance` (M,) is the noise's, which is taken out.
    """
    pairs, signs = reciprocal_channels(channels)
    reciprocity = None
    if 2 * len(pairs) >= MIN_RECIPROCAL_SHARE * len(channels):
        reciprocity = relative_change(readings, pairs, signs if signed else None, variance)
    reversed_pairs, reversed_signs = _partners(channels, channels[:, [1, 0, 2, 3]])
    reversal = relative_change(
        readings, reversed_pairs, -reversed_signs if signed else None, variance
    )
    turned_pairs, _ = _partners(channels, (channels + 1) % n_electrodes)
    is_read = np.isfinite(readings)
    power = np.sum(np.where(is_read, readings, 0.0) ** 2, axis=0) / np.maximum(
        is_read.sum(axis=0), 1
    )
    if variance is not None:
        power = np.maximum(power - variance, 0.0)
    rms = np.where(is_read.any(axis=0), np.sqrt(power), np.nan)[None]
    return Misfit(reciprocity, reversal, relative_change(rms, turned_pairs, None))


def relative_change(
    readings: np.ndarray,
    pairs: np.ndarray,
    signs: np.ndarray | None,
    variance: np.ndarray | None = None,
) -> float | None:
    """rms of v[j] - sign v[i] over pairs (i, j) (P, 2) of channels, relative to the readings' rms.

    `signs` (P,) are 1 where None; NaN is skipped. The noise's `variance` (M,) is taken out of both.
    None without any usable pair, and where most of the readings' power is noise.
    """
    reference, partner = readings[:, pairs[:, 0]], readings[:, pairs[:, 1]]
    if signs is not None:
        reference = reference * signs
    is_read = np.isfinite(reference) & np.isfinite(partner)
    power = np.sum(reference[is_read] ** 2 + partner[is_read] ** 2) / 2.0
    change = np.sum((partner - reference)[is_read] ** 2)
    if variance is not None:
        pair_noise = float(is_read.sum(axis=0) @ variance[pairs].sum(axis=1))
        power, change = power - pair_noise / 2.0, max(change - NOISE_MARGIN * pair_noise, 0.0)
        if power < MIN_SIGNAL_SHARE * pair_noise:
            return None
    return float(np.sqrt(change / power)) if power > 0 else None


def _partners(channels: np.ndarray, equivalents: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (k, partner) (P, 2) and signs (P,) of channels.

    The partner reads what row k of `equivalents` (M, 4) would, times the sign.
    """
    row_of_channel = {tuple(row): k for k, row in enumerate(channels.tolist())}
    pairs, signs = [], []
    for k, (source, sink, plus, minus) in enumerate(equivalents.tolist()):
        forms = {
            (source, sink, plus, minus): 1.0,
            (sink, source, minus, plus): 1.0,
            (sink, source, plus, minus): -1.0,
            (source, sink, minus, plus): -1.0,
        }
        for form, sign in forms.items():
            partner = row_of_channel.get(form)
            if partner is not None and partner != k:
                pairs.append((k, partner))
                signs.append(sign)
                break
    return np.array(pairs, dtype=int).reshape(-1, 2), np.array(signs)


@dataclass(frozen=True)
class KnownOrder:
    """A common order of channels.

    Drive by drive or measurement by measurement (`slow`), ascending or descending
    (`slow_reversed`); within it by one `end` of the other pair, ascending or `descending`, counted
    from electrode 0 (pyEIT `std`) or from the slow pair's own electrode (`from_own_electrode`;
    pyEIT `fmmu`, EIDORS `rotate_meas`).
    """

    slow: str
    slow_reversed: bool
    end: str
    from_own_electrode: bool
    descending: bool

    @property
    def name(self) -> str:
        """The name on the command line: `drive-plus-ascending-own`."""
        parts = [
            self.slow,
            "reversed" * self.slow_reversed,
            self.end,
            "descending" if self.descending else "ascending",
            "own" * self.from_own_electrode,
        ]
        return "-".join(part for part in parts if part)

    @property
    def sentence(self) -> str:
        """The order in words."""
        turn = " (descending)" if self.slow_reversed else ""
        run = "descending" if self.descending else "ascending"
        start = "the slow pair's own electrode" if self.from_own_electrode else "electrode 0"
        return f"{self.slow} by {self.slow}{turn}, {self.end} electrodes {run} from {start}"

    def permutation(self, channels: np.ndarray, n_electrodes: int) -> np.ndarray:
        """(M,): reading i belongs to channel permutation[i]."""
        slow = channels[:, ENDS.index(SLOW[self.slow][0])]
        fast = channels[:, ENDS.index(self.end)]
        key = (fast - slow) % n_electrodes if self.from_own_electrode else fast
        key, slow = (-key if self.descending else key), (-slow if self.slow_reversed else slow)
        return np.lexsort((key, slow))


ENDS = ("source", "sink", "plus", "minus")
SLOW = {"drive": ("source", ("plus", "minus")), "measurement": ("plus", ("source", "sink"))}
ORDERS = {
    order.name: order
    for slow, slow_reversed in itertools.product(SLOW, (False, True))
    for order in (
        KnownOrder(slow, slow_reversed, *variant)
        for variant in itertools.product(SLOW[slow][1], (False, True), (False, True))
    )
}


def known_orders(channels: np.ndarray, n_electrodes: int) -> dict[str, np.ndarray]:
    """Permutations (M,) of the channels for the orders of ORDERS: reading i belongs to channel
    permutation[i].

    Of orders that are equal for these channels the first is taken; the table's own is left out.
    """
    orders: dict[str, np.ndarray] = {}
    known_permutations = {tuple(range(len(channels)))}
    for name, order in ORDERS.items():
        permutation = order.permutation(channels, n_electrodes)
        if tuple(permutation) not in known_permutations:
            known_permutations.add(tuple(permutation))
            orders[name] = permutation
    return orders


def in_order(file: str | Path, name: str, channels: np.ndarray, n_electrodes: int) -> np.ndarray:
    """The channels (M, 4) of readings that are in the order `name`.

    Raises InputError naming `file` for a name that is not in ORDERS.
    """
    if name not in ORDERS:
        raise InputError(file, "order", repr(name), f"one of {', '.join(ORDERS)}")
    return channels[ORDERS[name].permutation(channels, n_electrodes)]


def reordered(readings: np.ndarray, permutation: np.ndarray) -> np.ndarray:
    """Readings (K, M) in the order of `permutation` (M,), put into the table's order."""
    ordered = np.empty_like(readings)
    ordered[:, permutation] = readings
    return ordered
