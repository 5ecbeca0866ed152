"""Where, and with what, a recording and its simulation differ.

Each statistic asks the residual for a set of directions: a law over the frames times a profile over
the channels, times nothing or times the touch's own signal. Under Gaussian noise the squared length
of the residual's part in them is chi², with as many degrees of freedom as directions are left once
those that were fitted are projected out. The directions come from the channel table, the frames'
columns and the simulation, never from the residual. Rows overlap in any way, with either sign, so
the false discovery rate is that of Benjamini & Yekutieli (Ann. Statist. 29, 2001), which needs no
independence.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import chi2, false_discovery_control

from eitskin.data.recording import Recording
from eitskin.diagnose.noise.reciprocity import parity
from eitskin.diagnose.verdict.misfit_drivers import Law, laws, load_direction, nearness

DISCOVERY = 0.05  # a row says that something differs below this q
FITTED = 1e-6  # a direction with less of its squared length left is a fitted one
SAME = 1e-12  # fitted directions are one below this, of squared lengths
LEAST = 1e-12  # squared length of a direction that is none, in noise units
COLUMNS = ["statistic", "site", "value", "dof", "p", "q", "sentence"]


def atlas(
    recording: Recording, residual: np.ndarray, simulated: np.ndarray, fitted: np.ndarray
) -> pd.DataFrame:
    """One row a statistic and site: statistic, site, value, dof, p, q, sentence; by p.

    residual, simulated (N, M): recording less simulation, and the simulation, both over the
    noise's sd; NaN where lost. fitted (N M, P): directions that were fitted, in the same units.
    Where the values are differences, each channel's constant counts as fitted. Rows whose
    directions were all fitted, or that the frames have no information for, are left out.
    """
    asked = _Asked(recording, residual, simulated, fitted)
    found = [row for row in _rows(asked) if row.dof > 0]
    p = np.array([float(chi2.sf(row.value, row.dof)) for row in found])
    q = false_discovery_control(p, method="by")
    table = pd.DataFrame(
        [
            (row.statistic, row.site, row.value, row.dof, p[k], q[k], _sentence(row.claim, q[k]))
            for k, row in enumerate(found)
        ],
        columns=COLUMNS,
    )
    return table.iloc[np.lexsort([-_surprise(table), table["p"]])].reset_index(drop=True)


@dataclass(frozen=True)
class _Row:
    statistic: str
    site: str
    claim: str
    value: float
    dof: int


@dataclass(frozen=True)
class _Part:
    """What one field and law have of the residual, channel by channel: products with the residual
    (M,) and with the fitted directions (P, M), and squared lengths (M,)."""

    product: np.ndarray
    shared: np.ndarray
    length: np.ndarray

    def of(self, profiles: np.ndarray) -> tuple[float, int]:
        """Squared length of the residual in the directions of channels (k,) int, each its own, or
        of profiles (M, k) over the channels; and the number of directions."""
        if profiles.dtype.kind == "i":
            alive = profiles[self.length[profiles] > LEAST]
            scale = 1.0 / np.sqrt(self.length[alive])
            return _length(self.product[alive] * scale, self.shared[:, alive] * scale)
        profiles = profiles[:, self.length @ profiles**2 > LEAST]
        if not profiles.shape[1]:
            return 0.0, 0
        gram = (profiles.T * self.length) @ profiles
        scale = 1.0 / np.sqrt(np.diag(gram))
        size, basis = np.linalg.eigh(gram * scale * scale[:, None])
        basis = basis[:, size > FITTED] / np.sqrt(size[size > FITTED])
        basis = profiles @ (basis * scale[:, None])
        return _length(self.product @ basis, self.shared @ basis)


class _Asked:
    """The residual and all that it is asked about; what is lost is 0 throughout."""

    def __init__(
        self, recording: Recording, residual: np.ndarray, simulated: np.ndarray, fitted: np.ndarray
    ):
        self.recording = recording
        self.channels = recording.channels
        self.touch = recording.frames["touch"].to_numpy(bool)
        self.there = np.isfinite(residual) & np.isfinite(simulated)
        self.count = np.maximum(self.there.sum(axis=0), 1)
        self.difference = recording.metadata["values"] == "difference"
        shape = residual.shape
        self.simulated = np.where(self.there, simulated, 0.0)
        columns = fitted.T.reshape(fitted.shape[1], *shape) * self.there
        self.fitted = _orthonormal(self.centred(columns).reshape(len(columns), residual.size))
        flat = self.centred(np.where(self.there, residual, 0.0)).ravel()
        flat = flat - (flat @ self.fitted.T) @ self.fitted
        self.residual, self.fitted = flat.reshape(shape), self.fitted.reshape(-1, *shape)
        still = self.there & ~self.touch[:, None]
        self.level = (self.simulated * still).sum(axis=0) / np.maximum(still.sum(axis=0), 1)
        signal = self.simulated - self.level
        self.signal = np.where(self.there & self.touch[:, None], signal, 0.0)
        self.weight = (self.signal**2).sum(axis=1)

    @property
    def size(self) -> int:
        """Degrees of freedom of the residual."""
        constants = int(self.there.any(axis=0).sum()) if self.difference else 0
        return int(self.there.sum()) - len(self.fitted) - constants

    def centred(self, values: np.ndarray) -> np.ndarray:
        """(..., N, M) less each channel's mean, where only differences were recorded."""
        if not self.difference:
            return values
        return values - self.there * (values.sum(axis=-2, keepdims=True) / self.count)

    def parts(self, courses: np.ndarray, field: np.ndarray | None = None) -> list[_Part]:
        """One a column of courses (N, J), each channel of the field (N, M) times the course."""
        field = self.there.astype(float) if field is None else field * self.there
        product = courses.T @ (field * self.residual)
        shared = np.array([courses.T @ (field * column) for column in self.fitted])
        shared = shared.reshape(len(self.fitted), *product.shape)
        length = (courses**2).T @ field**2
        if self.difference:
            left = length - (courses.T @ field) ** 2 / self.count
            length = np.where(left > FITTED * length, left, 0.0)
        return [_Part(product[j], shared[:, j], length[j]) for j in range(courses.shape[1])]


def _rows(asked: _Asked) -> Iterator[_Row]:
    every, touched = np.ones(len(asked.touch)), asked.touch.astype(float)
    always, untouched, pressed = asked.parts(np.column_stack([every, 1.0 - touched, touched]))
    (signal,) = asked.parts(every[:, None], asked.signal)
    flat = asked.residual.ravel()
    claim = "recording and simulation differ"
    yield _Row("everything", "", claim, float(flat @ flat), asked.size)
    yield from _of_channels("constant", "in every frame", always, asked)
    yield from _of_reciprocity("untouched", "in the untouched frames", untouched, asked)
    yield from _of_harmonics("untouched", "untouched frames", untouched, asked)
    if asked.touch.any():
        yield from _of_reciprocity("touched", "in the touched frames", pressed, asked)
        yield from _of_harmonics("touched", "touched frames", pressed, asked)
        yield from _of_channels("touch signal", "in the touch's signal", signal, asked)
        yield from _of_reciprocity("touch signal", "in the touch's signal", signal, asked)
    yield from _of_laws(asked)
    yield from _of_nearness(asked)
    yield from _of_scan(asked, always)
    yield from _of_amplitude(asked)


def _of_channels(statistic: str, how: str, part: _Part, asked: _Asked) -> Iterator[_Row]:
    """All channels, and those of each electrode, drive, measuring pair and separation."""
    count = len(asked.channels)
    claim = f"channels differ from the simulation {how}, each by its own amount"
    yield _Row(f"{statistic}: any channel", "", claim, *part.of(np.arange(count)))
    claim = f"all channels differ from the simulation {how}, by one share"
    share = asked.level[:, None] if statistic == "constant" else np.ones((count, 1))
    yield _Row(f"{statistic}: every channel", "", claim, *part.of(share))
    for where, sites in _sites(asked).items():
        for site, (name, channels) in sites.items():
            claim = f"{name} differs from the simulation {how}"
            yield _Row(f"{statistic}: {where}", site, claim, *part.of(channels))


def _sites(asked: _Asked) -> dict[str, dict[str, tuple[str, np.ndarray]]]:
    """For electrode, drive, measuring pair and separation: each site's name and channels.

    An electrode's contact bends the field of its neighbours' channels as well: with adjacent pairs
    the rows of the two electrodes beside it are as high.
    """
    channels = asked.channels
    source, sink, plus, minus = channels.T
    apart = (plus - source) % asked.recording.n_electrodes
    return {
        "electrode": _electrodes(channels),
        "drive": {
            f"{a} → {b}": (f"drive {a} → {b}", np.flatnonzero((source == a) & (sink == b)))
            for a, b in np.unique(channels[:, :2], axis=0)
        },
        "measuring pair": {
            f"{a} - {b}": (f"measuring pair {a} - {b}", np.flatnonzero((plus == a) & (minus == b)))
            for a, b in np.unique(channels[:, 2:], axis=0)
        },
        "separation": {
            str(k): (f"measuring {k} electrodes after the source", np.flatnonzero(apart == k))
            for k in np.unique(apart)
        },
    }


def _electrodes(channels: np.ndarray) -> dict[str, tuple[str, np.ndarray]]:
    """Each electrode's name and the channels (k,) that drive or measure with it."""
    return {
        str(k): (f"electrode {k}", np.flatnonzero((channels == k).any(axis=1)))
        for k in np.unique(channels)
    }


def _of_reciprocity(statistic: str, where: str, part: _Part, asked: _Asked) -> Iterator[_Row]:
    """Odd half and the rest; the touch's signal has its sign already."""
    signed = asked.recording.metadata["voltage"] == "signed" and statistic != "touch signal"
    odd, even = parity(asked.channels, signed)
    if not odd.shape[1]:
        return
    claim = f"exchanging drive and measurement changes the misfit {where}, as no skin does"
    yield _Row(f"{statistic}: reciprocity", "odd", claim, *part.of(odd))
    claim = f"the misfit {where} has a part that exchanging drive and measurement leaves alone"
    yield _Row(f"{statistic}: reciprocity", "even", claim, *part.of(even))


def _of_harmonics(statistic: str, where: str, part: _Part, asked: _Asked) -> Iterator[_Row]:
    """Harmonics of the misfit's mean over the drive's place on the ring, each kind of channel (up
    to a rotation) with its own cosine and sine."""
    n = asked.recording.n_electrodes
    kinds = _rotations(asked.channels, n)
    if len(set(kinds)) == len(kinds):
        return
    kind = pd.factorize(pd.Series(kinds, dtype=object))[0]
    own = (kind[:, None] == np.arange(kind.max() + 1)).astype(float)
    for k in range(n // 2 + 1):
        angle = 2.0 * np.pi * k * asked.channels[:, :1] / n
        waves = [own * np.cos(angle)]
        if 0 < 2 * k < n:
            waves.append(own * np.sin(angle))
        claim = f"the misfit of the {where} goes {k} times up and down round the ring"
        if k == 0:
            claim = f"the {where} have a misfit that is alike all round the ring"
        yield _Row(f"{statistic}: harmonic", str(k), claim, *part.of(np.hstack(waves)))


def _rotations(channels: np.ndarray, n_electrodes: int) -> list[tuple]:
    """What of each channel a rotation leaves: its electrodes counted from its source."""
    return [tuple(row) for row in ((channels - channels[:, :1]) % n_electrodes).tolist()]


def _of_laws(asked: _Asked) -> Iterator[_Row]:
    found = list(laws(asked.recording))
    if not found:
        return
    frames = np.ones(len(asked.touch))
    touched = asked.touch.astype(float)
    plain = np.column_stack([law.cleared(touched if _inside(law) else frames) for law in found])
    shares = np.column_stack([law.cleared(asked.weight) for law in found])
    rows = zip(found, asked.parts(plain), asked.parts(shares, asked.signal), strict=True)
    electrodes = _electrodes(asked.channels)
    for law, part, share in rows:
        every = np.arange(len(asked.channels))
        claim = f"the misfit {law.phrase}"
        yield _Row(f"{law.statistic}: any channel", law.site, claim, *part.of(every))
        claim = f"a misfit in proportion to the untouched readings {law.phrase}"
        level = asked.level[:, None]
        yield _Row(f"{law.statistic}: every reading", law.site, claim, *part.of(level))
        claim = f"the share by which the touch's signal is off {law.phrase}"
        alike = np.ones((len(asked.channels), 1))
        yield _Row(f"{law.statistic}: touch signal", law.site, claim, *share.of(alike))
        for site, (name, channels) in electrodes.items() if law.local else ():
            claim = f"the misfit at {name} {law.phrase}"
            yield _Row(f"{law.statistic}: electrode", site, claim, *part.of(channels))


def _inside(law: Law) -> bool:
    """Whether a law is about touched frames alone."""
    return law.touch and law.statistic != "touched"


def _of_nearness(asked: _Asked) -> Iterator[_Row]:
    """Touches near an electrode, in all channels and in its own."""
    near = nearness(asked.recording)
    if near is None or not asked.touch.any():
        return
    # Less their weighted mean: what one share of all touches explains is no matter of place.
    near = near - asked.weight @ near / max(asked.weight.sum(), LEAST)
    parts = asked.parts(near, asked.signal)
    for site, (name, channels) in _electrodes(asked.channels).items():
        profiles = np.ones((len(asked.channels), 2))
        profiles[:, 1] = np.isin(np.arange(len(asked.channels)), channels)
        claim = f"the share by which the touch's signal is off is other near {name}"
        yield _Row("position: electrode", site, claim, *parts[int(site)].of(profiles))


def _of_scan(asked: _Asked, always: _Part) -> Iterator[_Row]:
    """The order in which a frame's channels are read."""
    count = len(asked.channels)
    place = np.linspace(-0.5, 0.5, count)[:, None]
    claim = "the misfit drifts along the scan of each frame"
    yield _Row("scan: position", "", claim, *always.of(place))
    claim = "the first channel of each frame differs from the simulation"
    yield _Row("scan: first channel", "0", claim, *always.of(np.array([0])))
    steps = np.diff(asked.simulated, axis=1, prepend=asked.simulated[:, :1])
    (before,) = asked.parts(np.ones((len(steps), 1)), -steps)
    claim = "the misfit goes with the step from the channel read before"
    yield _Row("scan: channel before", "", claim, *before.of(np.ones((count, 1))))
    if asked.touch.any() and load_direction(asked.recording).any():
        course = load_direction(asked.recording)[:, None]
        (skewed,) = asked.parts(course, asked.signal)
        claim = "the touch's signal grows or shrinks along the scan while the force changes"
        yield _Row("scan: changing force", "", claim, *skewed.of(place))


def _of_amplitude(asked: _Asked) -> Iterator[_Row]:
    """Square and cube of the reading, beyond a constant and a share of it."""
    value = asked.simulated / max(np.abs(asked.simulated).max(), 1e-300)
    there = asked.there
    basis = np.column_stack([np.ones(there.sum()), value[there]])
    for power, name in ((2, "square"), (3, "cube")):
        raised = value[there] ** power
        field = np.zeros_like(value)
        field[there] = raised - basis @ np.linalg.lstsq(basis, raised, rcond=None)[0]
        (part,) = asked.parts(np.ones((len(value), 1)), field)
        claim = f"the misfit goes with the {name} of the reading"
        alike = np.ones((value.shape[1], 1))
        yield _Row(f"amplitude: {name}", "", claim, *part.of(alike))


def _length(product: np.ndarray, shared: np.ndarray) -> tuple[float, int]:
    """Squared length of the residual in orthonormal directions less their fitted parts.

    product (k,) with the residual, shared (P, k) with orthonormal fitted directions; one that is
    fitted counts as none.
    """
    if not len(product):
        return 0.0, 0
    _, size, right = np.linalg.svd(shared, full_matrices=False)
    along = right @ product
    left = 1.0 - size**2
    free = left > FITTED
    outside = product @ product - along @ along
    inside = np.sum(along[free] ** 2 / left[free])
    return float(max(outside, 0.0) + inside), int(len(product) - (~free).sum())


def _orthonormal(rows: np.ndarray) -> np.ndarray:
    """(R, K) orthonormal rows that span rows (P, K), K far above P: twice by the Gram matrix, since
    once loses as many digits as its condition has."""
    length = np.linalg.norm(rows, axis=1)
    rows = rows[length > 0.0] / length[length > 0.0, None]
    for _ in range(2):
        size, mix = np.linalg.eigh(rows @ rows.T)
        kept = size > SAME * size.max(initial=0.0)
        rows = (mix[:, kept] / np.sqrt(size[kept])).T @ rows
    return rows


def _surprise(table: pd.DataFrame) -> np.ndarray:
    """(R,) how far each value is beyond its degrees of freedom, where p-values are all 0."""
    return ((table["value"] - table["dof"]) / np.sqrt(2.0 * table["dof"])).to_numpy()


def _sentence(claim: str, q: float) -> str:
    if q > DISCOVERY:
        return f"No evidence that {claim}."
    return f"{claim[0].upper()}{claim[1:]}."
