"""What a fault of the instrument would change, from the control's own readings.

No signature needs a model of the skin: a gain changes a reading by a share of itself, an offset by
a constant, memory by the reading before, and crossed wires read what other channels read
(`potentials`). What follows no such law is a block of channels, each with a value of its own.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.diagnose.compare.potentials import Potentials

TONES_HZ = (50.0, 60.0)
CHANNEL, DRIVE, MEASURE, ELECTRODE = "channels", "drives", "measures", "electrodes"
MOST_CROSSED = 12  # electrode pairs that are fitted of all that could be crossed


@dataclass(frozen=True)
class Signature:
    """A fault at a site. sites: numbers of a kind, none where kind is None; basis (M, k): the
    change by each free size; shift (M,): a change of known size."""

    name: str
    kind: str | None
    sites: tuple[int, ...]
    basis: np.ndarray
    shift: np.ndarray | None = None


@dataclass(frozen=True)
class Control:
    """What signatures are made from: the channels that were read, their mean readings (M,) with 0
    where lost, whether they are signed, and when each is read (M,) s, None where unknown."""

    potentials: Potentials
    mean: np.ndarray
    signed: bool
    moment_s: np.ndarray | None = None

    @property
    def channels(self) -> np.ndarray:
        """(M, 4): source, sink, plus, minus."""
        return self.potentials.channels

    @property
    def n(self) -> int:
        """Electrodes."""
        return self.potentials.n

    @property
    def read(self) -> np.ndarray:
        """(M,): which channels have readings."""
        return self.potentials.read

    @property
    def sign(self) -> np.ndarray | None:
        """(M,): what makes readings signed; None where nobody can tell."""
        return np.ones(len(self.mean)) if self.signed else _signs(self.channels, self.n)


def _signs(channels: np.ndarray, n: int) -> np.ndarray | None:
    """(M,): which way magnitudes would read if potentials fall from source to sink both ways round
    the rim, electrodes being numbered round it; None where a pair straddles an end."""
    source, sink, plus, minus = channels.T
    span = (sink - source) % n
    place = [(each - source) % n for each in (plus, minus)]
    depth = [np.where(p <= span, p / span, (n - p) / (n - span)) for p in place]
    same_side = (place[0] <= span) == (place[1] <= span)
    ends = [(p == 0) | (p == span) for p in place]
    if not (same_side | ends[0] | ends[1]).all():
        return None
    return np.where(depth[0] < depth[1], 1.0, -1.0)


def families(control: Control) -> list[list[Signature]]:
    """Signatures with sites, a list for each kind of fault; several sites of one may be there."""
    mean, channels = control.mean, control.channels
    source, sink, plus, minus = channels.T
    one = control.read.astype(float)
    of_electrode = [(channels == e).any(axis=1) for e in range(control.n)]
    driving = [(source == e) | (sink == e) for e in range(control.n)]
    measuring = [(plus == e) | (minus == e) for e in range(control.n)]
    found = [
        [
            Signature("channel-gain", CHANNEL, (int(m),), np.eye(len(mean))[:, [m]])
            for m in np.flatnonzero(control.read)
        ],
        [_scaled("drive-gain", DRIVE, d, mean, source == d) for d in np.unique(source)],
        [_scaled("measurement-gain", MEASURE, p, mean, plus == p) for p in np.unique(plus)],
        *(
            [_scaled("electrode-gain", ELECTRODE, e, mean, uses[e]) for e in range(control.n)]
            for uses in (of_electrode, driving, measuring)
        ),
        [_pairs_of(e, control) for e in range(control.n)],
        [_block("drive-pair", DRIVE, d, (source == d) & control.read) for d in np.unique(source)],
        [_block("measuring-pair", MEASURE, p, (plus == p) & control.read) for p in np.unique(plus)],
        [
            _block("electrode", ELECTRODE, e, of_electrode[e] & control.read)
            for e in range(control.n)
        ],
    ]
    if control.signed:
        found.append([_scaled("offset", MEASURE, p, one, plus == p) for p in np.unique(plus)])
        found.append(_wire_gains(control))
    return [[s for s in family if s.basis.any()] for family in found]


def _scaled(name: str, kind: str, site: int, values: np.ndarray, where: np.ndarray) -> Signature:
    return Signature(name, kind, (int(site),), (values * where)[:, None])


def _block(name: str, kind: str, site: int, where: np.ndarray) -> Signature:
    return Signature(name, kind, (int(site),), np.eye(len(where))[:, where])


def _pairs_of(e: int, control: Control) -> Signature:
    """Every drive and every measuring pair of an electrode with a gain of its own."""
    columns = []
    for pair in (control.channels[:, :2], control.channels[:, 2:]):
        used = (pair == e).any(axis=1)
        for each in np.unique(pair[used], axis=0):
            columns.append(control.mean * (pair == each).all(axis=1))
    basis = np.reshape(columns, (-1, len(control.mean))).T
    return Signature("electrode", ELECTRODE, (e,), basis)


def _wire_gains(control: Control) -> list[Signature]:
    """One electrode's voltage before the difference is taken, relative to all electrodes' mean."""
    impedances = control.potentials.impedances(control.mean)
    source, sink, plus, minus = control.channels.T
    found = []
    for e in range(control.n):
        level = impedances[source, e] - impedances[sink, e]
        sign = (plus == e) * 1.0 - (minus == e)
        basis = (sign * level * control.read)[:, None]
        found.append(Signature("electrode-gain", ELECTRODE, (e,), basis))
    return found


def everywhere(control: Control) -> list[Signature]:
    """Signatures without a site."""
    mean, read = control.mean, control.read
    before, after = np.roll(mean, 1), np.roll(mean, -1)
    whole = read & np.roll(read, 1)
    found = [("multiplexer-memory", (before - mean) * whole)]
    whole = whole & np.roll(read, -1)
    found.append(("crosstalk", (before + after - 2.0 * mean) * whole))
    found.append(("adc-nonlinearity", mean**3 * read))
    if control.signed:
        found.append(("offset", read.astype(float)))
    return [Signature(name, None, (), values[:, None]) for name, values in found]


def tones(control: Control) -> list[Signature]:
    """The mains, at rest in the frame: a cosine and a sine over the moments of reading."""
    if control.moment_s is None or not control.signed:
        return []
    found = []
    for tone in TONES_HZ:
        angle = 2.0 * np.pi * tone * control.moment_s
        basis = np.column_stack([np.cos(angle), np.sin(angle)]) * control.read[:, None]
        found.append(Signature("mains-interference", None, (), basis))
    return found


def crossed(control: Control, change: np.ndarray, scale: np.ndarray) -> list[Signature]:
    """Two wires exchanged: the pairs that leave least of the change (M,), in units of scale (M,).

    Channels that would read what follows from none that was read have a value of their own.
    """
    sign = control.sign
    if sign is None:
        return []
    potentials = control.potentials
    impedances = potentials.impedances(sign * control.mean)
    white = change / scale
    used = np.unique(control.channels).tolist()
    tried = []
    for i, a in enumerate(used):
        for b in used[i + 1 :]:
            values, known = potentials.crossed(impedances, a, b)
            if not control.signed:
                values = np.abs(values)
            shift = np.where(known & control.read, values - control.mean, 0.0)
            open_ = ~known & control.read
            moved = np.abs(shift) > 0
            if not (moved & known).any():
                continue
            left = np.where(known, white - shift / scale, 0.0)
            gain = (white[known] ** 2).sum() - (left**2).sum()
            tried.append((gain, (a, b), shift, open_))
    tried.sort(key=lambda each: -each[0])
    return [
        Signature("electrode-swap", ELECTRODE, pair, np.eye(len(white))[:, open_], shift)
        for _, pair, shift, open_ in tried[:MOST_CROSSED]
    ]


def clipped(control: Control, reached: np.ndarray) -> Signature:
    """Readings that no longer go beyond a limit, which some channels (M,) reach."""
    return Signature("adc-nonlinearity", None, (), np.eye(len(reached))[:, reached & control.read])
