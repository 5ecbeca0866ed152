"""Channel tables: which electrodes drive and which are measured, one row a channel."""

import re

import numpy as np

from eitskin.errors import InputError

PATTERNS = "adjacent, opposite or skip-<n>"


def pattern_step(pattern: str, n_electrodes: int) -> int:
    """Electrodes from the first to the second of a pair: adjacent 1, skip-n n + 1, opposite n/2.

    Raises InputError for an unknown pattern or one that reaches round to its own electrode.
    """
    skip = re.fullmatch(r"skip-([0-9]{1,4})", pattern)
    if pattern == "adjacent":
        step = 1
    elif pattern == "opposite" and n_electrodes % 2 == 0:
        step = n_electrodes // 2
    elif skip:
        step = int(skip[1]) + 1
    else:
        raise InputError("protocol", "pattern", repr(pattern), PATTERNS)
    if step >= n_electrodes:
        raise InputError("protocol", "pattern", repr(pattern), f"a pair among {n_electrodes}")
    return step


def channel_table(
    n_electrodes: int,
    drive: str = "adjacent",
    measure: str = "adjacent",
    channels: list[list[int]] | None = None,
) -> np.ndarray:
    """Channels (M, 4) int: source, sink, plus, minus; drive-major, measurement ascending.

    Every electrode is once the source and, in each drive, once the plus; pairs that touch a driven
    electrode are left out (pyEIT's `std` order for adjacent/adjacent: M = n (n - 3)). `channels`:
    the table itself, where no patterns make it. Raises InputError for an unknown pattern, where
    every pair touches a driven electrode, and for a channel of electrodes that are not there or of
    one with itself.
    """
    n = n_electrodes
    if channels is not None:
        for k, (source, sink, plus, minus) in enumerate(channels):
            in_range = all(0 <= electrode < n for electrode in channels[k])
            if not in_range or source == sink or plus == minus:
                expected = f"two pairs of different electrodes, 0 to {n - 1}"
                raise InputError("protocol", f"channels[{k}]", channels[k], expected)
        return np.array(channels, dtype=int)
    rows = every_channel(n, drive, measure)
    rows = rows[undriven(rows)]
    if not len(rows):
        actual = f"no channel is left with {drive} drive and {measure} measurement"
        raise InputError("protocol", "drive, measure", actual, f"other pairs of {n} electrodes")
    return rows


def every_channel(n_electrodes: int, drive: str, measure: str) -> np.ndarray:
    """(n n, 4): as `channel_table`, with the pairs that touch a driven electrode.

    Raises InputError for an unknown pattern.
    """
    n = n_electrodes
    drive_step, measure_step = pattern_step(drive, n), pattern_step(measure, n)
    source, plus = (index.ravel() for index in np.indices((n, n)))
    return np.stack([source, (source + drive_step) % n, plus, (plus + measure_step) % n], axis=1)


def undriven(channels: np.ndarray) -> np.ndarray:
    """(M,) bool: whether neither measured electrode is driven, of channels (M, 4)."""
    return ~(channels[:, :2, None] == channels[:, None, 2:]).any(axis=(1, 2))


def reciprocal_channels(channels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of channels with drive and measurement exchanged.

    Returns (P, 2) int, first < second, and (P,) sign: v[second] = sign * v[first] for a passive,
    linear skin (sign -1 where the polarity of one pair is reversed).
    """
    index = {tuple(row): k for k, row in enumerate(channels.tolist())}
    pairs, signs = [], []
    for k, (source, sink, plus, minus) in enumerate(channels.tolist()):
        candidates = {
            (plus, minus, source, sink): 1,
            (minus, plus, sink, source): 1,
            (plus, minus, sink, source): -1,
            (minus, plus, source, sink): -1,
        }
        for row, sign in candidates.items():
            partner = index.get(row)
            if partner is not None and partner > k:
                pairs.append((k, partner))
                signs.append(sign)
                break
    return np.array(pairs, dtype=int).reshape(-1, 2), np.array(signs, dtype=float)


def tied_channels(channels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(M,) each, of channels (M, 4): a label shared by all channels that reciprocity ties to one
    value, directly or through others, and the sign with which each has that value."""
    pairs, signs = reciprocal_channels(channels)
    label, sign = np.arange(len(channels)), np.ones(len(channels))
    for (channel, partner), pair_sign in zip(pairs, signs, strict=True):
        if label[channel] != label[partner]:
            members = label == label[partner]
            sign[members] *= pair_sign * sign[channel] * sign[partner]
            label[members] = label[channel]
    return label, sign
