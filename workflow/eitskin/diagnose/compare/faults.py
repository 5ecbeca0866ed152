"""What a fault of the instrument would change, from the control's own readings.

No signature needs a model of the skin: a gain changes a reading by a share of itself, an offset by
a constant, memory by the reading before, and exchanged wires read what other channels read
(`potentials`). What follows no such law is a block of channels, each with a value of its own.
"""

from dataclasses import dataclass

import numpy as np

from eitskin.diagnose.compare.potentials import Potentials

TONES_HZ = (50.0, 60.0)  # of the mains: IEC 60038
CHANNEL, DRIVE, MEASURE, ELECTRODE = "channels", "drives", "measures", "electrodes"
MOST_SWAPS = (
    12  # pairs of electrodes that are fitted, of all that could be exchanged: the likeliest
)


@dataclass(frozen=True)
class Signature:
    """A fault at a site: the changes basis @ sizes + shift.

    sites: numbers of a kind, none where kind is None; basis (M, k): the change by each free size;
    shift (M,), V: a change of known size.
    """

    name: str
    kind: str | None
    sites: tuple[int, ...]
    basis: np.ndarray
    shift: np.ndarray | None = None


@dataclass(frozen=True)
class Control:
    """The recording that signatures are made from.

    potentials: of the channels that were read; mean (M,), V: their mean readings, 0 where lost;
    signed: whether these are; moment_s (M,): when each is read within a frame, None where unknown.
    """

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
        """Number of electrodes."""
        return self.potentials.n

    @property
    def read(self) -> np.ndarray:
        """(M,) bool: which channels have readings."""
        return self.potentials.read

    @property
    def sign(self) -> np.ndarray | None:
        """(M,): the factors that make readings signed; None where they are unknown."""
        return np.ones(len(self.mean)) if self.signed else _falling_signs(self.channels, self.n)


def _falling_signs(channels: np.ndarray, n: int) -> np.ndarray | None:
    """Signs (M,) of readings whose potentials fall from source to sink both ways round the rim.

    Electrodes are numbered round the rim. None where a pair straddles source or sink.
    """
    source, sink, plus, minus = channels.T
    span = (sink - source) % n
    steps = [(electrode - source) % n for electrode in (plus, minus)]
    depth = [np.where(p <= span, p / span, (n - p) / (n - span)) for p in steps]
    same_side = (steps[0] <= span) == (steps[1] <= span)
    driven = [(p == 0) | (p == span) for p in steps]
    if not (same_side | driven[0] | driven[1]).all():
        return None
    return np.where(depth[0] < depth[1], 1.0, -1.0)


def families(control: Control) -> list[list[Signature]]:
    """Signatures with sites, a list for each kind of fault; several sites of one kind may be at
    fault together."""
    mean, channels = control.mean, control.channels
    source, sink, plus, minus = channels.T
    unit = control.read.astype(float)
    electrodes, drives, measures = range(control.n), np.unique(source), np.unique(plus)
    using = [(channels == e).any(axis=1) for e in electrodes]
    driving = [(source == e) | (sink == e) for e in electrodes]
    measuring = [(plus == e) | (minus == e) for e in electrodes]
    all_families = [
        [
            Signature("channel-gain", CHANNEL, (int(m),), np.eye(len(mean))[:, [m]])
            for m in np.flatnonzero(control.read)
        ],
        [_gain("drive-gain", DRIVE, d, mean, source == d) for d in drives],
        [_gain("measurement-gain", MEASURE, p, mean, plus == p) for p in measures],
        *(
            [_gain("electrode-gain", ELECTRODE, e, mean, mask[e]) for e in electrodes]
            for mask in (using, driving, measuring)
        ),
        [_pair_gains(e, control) for e in electrodes],
        [_block("drive-pair", DRIVE, d, (source == d) & control.read) for d in drives],
        [_block("measuring-pair", MEASURE, p, (plus == p) & control.read) for p in measures],
        [_block("electrode", ELECTRODE, e, using[e] & control.read) for e in electrodes],
    ]
    if control.signed:
        all_families.append([_gain("offset", MEASURE, p, unit, plus == p) for p in measures])
        all_families.append(_wire_gains(control))
    return [[s for s in family if s.basis.any()] for family in all_families]


def _gain(name: str, kind: str, site: int, values: np.ndarray, mask: np.ndarray) -> Signature:
    """A share of values (M,) in the channels of a mask (M,)."""
    return Signature(name, kind, (int(site),), (values * mask)[:, None])


def _block(name: str, kind: str, site: int, mask: np.ndarray) -> Signature:
    """A free change of each channel of a mask (M,)."""
    return Signature(name, kind, (int(site),), np.eye(len(mask))[:, mask])


def _pair_gains(e: int, control: Control) -> Signature:
    """A gain for each drive and each measuring pair of an electrode."""
    columns = []
    for pairs in (control.channels[:, :2], control.channels[:, 2:]):
        using = (pairs == e).any(axis=1)
        for pair in np.unique(pairs[using], axis=0):
            columns.append(control.mean * (pairs == pair).all(axis=1))
    basis = np.reshape(columns, (-1, len(control.mean))).T
    return Signature("electrode", ELECTRODE, (e,), basis)


def _wire_gains(control: Control) -> list[Signature]:
    """A gain of one electrode's voltage, relative to the mean of all electrodes, before the
    difference of plus and minus is taken."""
    impedances = control.potentials.impedances(control.mean)
    source, sink, plus, minus = control.channels.T
    signatures = []
    for e in range(control.n):
        level = impedances[source, e] - impedances[sink, e]
        sign = (plus == e) * 1.0 - (minus == e)
        basis = (sign * level * control.read)[:, None]
        signatures.append(Signature("electrode-gain", ELECTRODE, (e,), basis))
    return signatures


def siteless(control: Control) -> list[Signature]:
    """Signatures without a site, each a family by itself."""
    mean, read = control.mean, control.read
    previous, following = np.roll(mean, 1), np.roll(mean, -1)
    both_read = read & np.roll(read, 1)
    changes = [("multiplexer-memory", (previous - mean) * both_read)]
    all_read = both_read & np.roll(read, -1)
    changes.append(("crosstalk", (previous + following - 2.0 * mean) * all_read))
    changes.append(("adc-nonlinearity", mean**3 * read))
    if control.signed:
        changes.append(("offset", read.astype(float)))
    return [Signature(name, None, (), change[:, None]) for name, change in changes]


def tones(control: Control) -> list[Signature]:
    """The mains, at rest in the frame: a cosine and a sine over the moments of reading."""
    if control.moment_s is None or not control.signed:
        return []
    signatures = []
    for tone in TONES_HZ:
        angle = 2.0 * np.pi * tone * control.moment_s
        basis = np.column_stack([np.cos(angle), np.sin(angle)]) * control.read[:, None]
        signatures.append(Signature("mains-interference", None, (), basis))
    return signatures


def swaps(control: Control, change: np.ndarray, scale: np.ndarray) -> list[Signature]:
    """Exchanged wires of two electrodes: the pairs that leave least of the change (M,), V, in units
    of scale (M,), V.

    Channels whose readings after the exchange follow from none before have a free change each.
    """
    sign = control.sign
    if sign is None:
        return []
    potentials = control.potentials
    impedances = potentials.impedances(sign * control.mean)
    white = change / scale
    electrodes = np.unique(control.channels).tolist()
    candidates = []
    for i, a in enumerate(electrodes):
        for b in electrodes[i + 1 :]:
            values, determined = potentials.exchanged(impedances, a, b)
            if not control.signed:
                values = np.abs(values)
            shift = np.where(determined & control.read, values - control.mean, 0.0)
            undetermined = ~determined & control.read
            if not ((np.abs(shift) > 0) & determined).any():
                continue
            residual = np.where(determined, white - shift / scale, 0.0)
            gain = (white[determined] ** 2).sum() - (residual**2).sum()
            candidates.append((gain, (a, b), shift, undetermined))
    candidates.sort(key=lambda candidate: -candidate[0])
    return [
        Signature("electrode-swap", ELECTRODE, pair, np.eye(len(white))[:, undetermined], shift)
        for _, pair, shift, undetermined in candidates[:MOST_SWAPS]
    ]


def clipping(control: Control, limited: np.ndarray) -> Signature:
    """A free change of each channel that reaches the converter's limit (M,) bool."""
    return Signature("adc-nonlinearity", None, (), np.eye(len(limited))[:, limited & control.read])
