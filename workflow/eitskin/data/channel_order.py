"""Whether readings stand in the order that their channel table says.

A passive linear skin reads the same with drive and measurement exchanged (reciprocity). Where no
channel has its reciprocal in the table, two weaker identities are left: exchanging source and sink
turns the sign and nothing else (any skin), and turning drive and measurement by one electrode
changes little (an even skin). A table that is wrong breaks them at once.
"""

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eitskin.errors import InputError
from eitskin.physics.protocol import reciprocal_channels

LEAST_RECIPROCAL = 0.25


@dataclass(frozen=True)
class Misfit:
    """How badly readings break the identities of their channel table; rms, relative to the
    readings.

    `overall` is the reciprocity where there is one, else the rms of reversal and rotation.
    """

    reciprocity: float | None
    reversal: float | None
    rotation: float | None

    @property
    def overall(self) -> float | None:
        """None where the table has none of the identities."""
        if self.reciprocity is not None:
            return self.reciprocity
        weaker = [value for value in (self.reversal, self.rotation) if value is not None]
        return float(np.sqrt(np.mean(np.square(weaker)))) if weaker else None


def misfit(readings: np.ndarray, channels: np.ndarray, n_electrodes: int, signed: bool) -> Misfit:
    """Misfit of readings (K, M), K frames, to channels (M, 4); NaN readings are left out.

    Rotation compares the channels' rms over frames, so that touches off the centre do not count.
    """
    pairs, signs = reciprocal_channels(channels)
    reciprocity = None
    if 2 * len(pairs) >= LEAST_RECIPROCAL * len(channels):
        reciprocity = relative_change(readings, pairs, signs if signed else np.ones(len(pairs)))
    reversed_pairs, reversed_signs = _partners(channels, channels[:, [1, 0, 2, 3]])
    reversal = relative_change(readings, reversed_pairs, -reversed_signs if signed else None)
    turned_pairs, _ = _partners(channels, (channels + 1) % n_electrodes)
    kept = np.isfinite(readings)
    power = np.sum(np.where(kept, readings, 0.0) ** 2, axis=0) / np.maximum(kept.sum(axis=0), 1)
    rms = np.where(kept.any(axis=0), np.sqrt(power), np.nan)[None]
    return Misfit(reciprocity, reversal, relative_change(rms, turned_pairs, None))


def relative_change(
    readings: np.ndarray, pairs: np.ndarray, signs: np.ndarray | None
) -> float | None:
    """rms of v[second] - sign v[first] over pairs (P, 2), relative to the readings' rms."""
    first, second = readings[:, pairs[:, 0]], readings[:, pairs[:, 1]]
    if signs is not None:
        first = first * signs
    kept = np.isfinite(first) & np.isfinite(second)
    power = np.sum(first[kept] ** 2 + second[kept] ** 2) / 2.0
    return float(np.sqrt(np.sum((second - first)[kept] ** 2) / power)) if power > 0 else None


def _partners(channels: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Channels (k, partner), (P, 2): the partner measures what row k of `others` would, times the
    sign (P,).
    """
    index = {tuple(row): k for k, row in enumerate(channels.tolist())}
    pairs, signs = [], []
    for k, (source, sink, plus, minus) in enumerate(others.tolist()):
        forms = {
            (source, sink, plus, minus): 1.0,
            (sink, source, minus, plus): 1.0,
            (sink, source, plus, minus): -1.0,
            (source, sink, minus, plus): -1.0,
        }
        for form, sign in forms.items():
            partner = index.get(form)
            if partner is not None and partner != k:
                pairs.append((k, partner))
                signs.append(sign)
                break
    return np.array(pairs, dtype=int).reshape(-1, 2), np.array(signs)


@dataclass(frozen=True)
class KnownOrder:
    """An order in which channels are commonly read: drive by drive or measurement by measurement,
    either ascending or descending (`slow_reversed`); within it by one `end` of the other pair,
    ascending or `descending`, counted from electrode 0 (pyEIT `std`) or from the slow pair's own
    electrode onwards (`own`; pyEIT `fmmu`, EIDORS `rotate_meas`)."""

    slow: str
    slow_reversed: bool
    end: str
    own: bool
    descending: bool

    @property
    def name(self) -> str:
        """What a person types: `drive-plus-ascending-own`."""
        parts = [
            self.slow,
            "reversed" * self.slow_reversed,
            self.end,
            "descending" if self.descending else "ascending",
            "own" * self.own,
        ]
        return "-".join(part for part in parts if part)

    @property
    def sentence(self) -> str:
        """What a person reads."""
        turn = " (descending)" if self.slow_reversed else ""
        run = "descending" if self.descending else "ascending"
        start = "the slow pair's own electrode" if self.own else "electrode 0"
        return f"{self.slow} by {self.slow}{turn}, {self.end} electrodes {run} from {start}"

    def permutation(self, channels: np.ndarray, n_electrodes: int) -> np.ndarray:
        """(M,): reading i belongs to channel permutation[i]."""
        slow = channels[:, ENDS.index(SLOW[self.slow][0])]
        fast = channels[:, ENDS.index(self.end)]
        key = (fast - slow) % n_electrodes if self.own else fast
        key, slow = (-key if self.descending else key), (-slow if self.slow_reversed else slow)
        return np.lexsort((key, slow))


ENDS = ("source", "sink", "plus", "minus")
SLOW = {"drive": ("source", ("plus", "minus")), "measurement": ("plus", ("source", "sink"))}
ORDERS = {
    order.name: order
    for slow, slow_reversed in itertools.product(SLOW, (False, True))
    for order in (
        KnownOrder(slow, slow_reversed, *rest)
        for rest in itertools.product(SLOW[slow][1], (False, True), (False, True))
    )
}


def known_orders(channels: np.ndarray, n_electrodes: int) -> dict[str, np.ndarray]:
    """Other orders in which the same channels are commonly read, by the names of ORDERS.

    Each is a permutation (M,): reading i belongs to channel permutation[i]. Of orders that are the
    same for these channels the first counts; those that equal the table's own are left out.
    """
    orders: dict[str, np.ndarray] = {}
    seen = {tuple(range(len(channels)))}
    for name, order in ORDERS.items():
        permutation = order.permutation(channels, n_electrodes)
        if tuple(permutation) not in seen:
            seen.add(tuple(permutation))
            orders[name] = permutation
    return orders


def in_order(file: str | Path, name: str, channels: np.ndarray, n_electrodes: int) -> np.ndarray:
    """(M, 4): the channels to which readings belong that stand in the order `name`.

    Raises InputError for a name that ORDERS has not.
    """
    if name not in ORDERS:
        raise InputError(file, "order", repr(name), f"one of {', '.join(ORDERS)}")
    return channels[ORDERS[name].permutation(channels, n_electrodes)]


def reordered(readings: np.ndarray, permutation: np.ndarray) -> np.ndarray:
    """Readings (K, M) that stand in the order of `permutation`, put into the table's own order."""
    result = np.empty_like(readings)
    result[:, permutation] = readings
    return result
