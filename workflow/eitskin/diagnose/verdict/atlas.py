"""Where, and with what, a recording and its simulation differ.

Each statistic asks the residual for a set of directions: a law over the frames times a profile over
the channels, times nothing or times the touch's own signal. Under Gaussian noise the squared length
of the residual's part in them is chi², with as many degrees of freedom as directions are left once
those that were fitted are projected out. The directions come from the channel table, the frames'
columns and the simulation, never from the residual. Rows overlap in any way, with either sign, so
the false discovery rate is that of Benjamini & Yekutieli (Ann. Statist. 29, 2001), which needs no
independence.

What the covariance does not know of a rig makes such parts longer than it allows. `free_p` has no
need of a covariance: a part must be longer than its odd half lets expect, for noise of any spectrum
has as much of it in the odd half of reciprocity, where no skin has any; without such a half, longer
than its scatter from press to press does, which takes noise for shorter than a press.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.stats import chi2, f, false_discovery_control

from eitskin.data.recording import Recording
from eitskin.diagnose.fitting.held_out import error_units
from eitskin.diagnose.noise.noise_combinations import LEAST_COMBINATIONS
from eitskin.diagnose.noise.reciprocity import parity
from eitskin.diagnose.verdict.misfit_drivers import Law, laws, load_direction, nearness

DISCOVERY = 0.05  # a row says that something differs below this q: one in twenty such is chance
FITTED_SHARE = (
    1e-6  # of its squared length; a direction keeps less of it when it was fitted: roundings
)
DEPENDENT_SHARE = 1e-12  # of squared lengths; directions that share more are one
ZERO_LENGTH = 1e-12  # squared, of a direction that is none, in noise units
LEAST_UNITS = 5  # fewer hardly show a scatter
COLUMNS = ["statistic", "site", "value", "dof", "p", "q", "free_p", "sentence"]


def atlas(
    recording: Recording,
    residual: np.ndarray,
    simulated: np.ndarray,
    fitted: np.ndarray,
    noise_dof: float = np.inf,
) -> pd.DataFrame:
    """One row a statistic and site: statistic, site, value, dof, p, q, free_p, sentence; by p.

    residual, simulated (N, M): recording less simulation, and the simulation, both over the
    noise's sd; NaN where lost. fitted (N M, P): directions that were fitted, in the same units.
    noise_dof: degrees of freedom of the noise's scale; infinite where that is known.
    Where the values are differences, each channel's constant counts as fitted. Rows whose
    directions were all fitted, or that the frames have no information for, are left out.
    """
    misfit = _Misfit(recording, residual, simulated, fitted)
    rows = [row for row in _rows(misfit) if row.dof > 0]
    p = np.array([_p_value(row.value, row.dof, noise_dof) for row in rows])
    q = false_discovery_control(p, method="by")
    table = pd.DataFrame(
        [
            (*row.identity, row.value, row.dof, p[k], q[k], row.free_p, _sentence(row.claim, q[k]))
            for k, row in enumerate(rows)
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
    free_p: float = 0.0

    @property
    def identity(self) -> tuple[str, str]:
        """Statistic and site."""
        return self.statistic, self.site


@dataclass(frozen=True)
class _Projection:
    """Of one field times one law, channel by channel: products with the residual in each unit of
    frames (B, M) and with the fitted directions (P, M), and squared lengths (M,); odd (M, O): half
    of reciprocity."""

    products: np.ndarray
    shared: np.ndarray
    length: np.ndarray
    odd: np.ndarray

    def explained(self, profiles: np.ndarray) -> tuple[float, int, float]:
        """Squared length of the residual in the directions of channels (k,) int, each by itself,
        or of profiles (M, k) over the channels; the number of directions; and the p-value of the
        length without a covariance, 0 where nothing tells it."""
        products, dof = self._free_products(profiles)
        total = products.sum(axis=0)
        square = float(total @ total)
        if dof == 0:
            return square, dof, 1.0
        odd_square, odd_dof = self._odd
        if odd_dof >= LEAST_COMBINATIONS:
            ratio = square / dof / max(odd_square / odd_dof, ZERO_LENGTH)
            return square, dof, float(f.sf(ratio, dof, odd_dof))
        return square, dof, repeat_p_value(products) if len(products) >= LEAST_UNITS else 0.0

    @cached_property
    def _odd(self) -> tuple[float, int]:
        """Squared length of the residual in the odd half, and its number of directions."""
        if not self.odd.shape[1]:
            return 0.0, 0
        products, dof = self._free_products(self.odd)
        return float((products.sum(axis=0) ** 2).sum()), dof

    def _free_products(self, profiles: np.ndarray) -> tuple[np.ndarray, int]:
        """(B, k) products with orthonormal directions of channels or profiles, less their fitted
        parts, and the number of directions that are left."""
        if profiles.dtype.kind == "i":
            channels = profiles[self.length[profiles] > ZERO_LENGTH]
            scale = 1.0 / np.sqrt(self.length[channels])
            return _unfitted(self.products[:, channels] * scale, self.shared[:, channels] * scale)
        profiles = profiles[:, self.length @ profiles**2 > ZERO_LENGTH]
        if not profiles.shape[1]:
            return np.zeros((len(self.products), 0)), 0
        gram = (profiles.T * self.length) @ profiles
        scale = 1.0 / np.sqrt(np.diag(gram))
        eigenvalues, basis = np.linalg.eigh(gram * scale * scale[:, None])
        is_direction = eigenvalues > FITTED_SHARE
        basis = basis[:, is_direction] / np.sqrt(eigenvalues[is_direction])
        basis = profiles @ (basis * scale[:, None])
        return _unfitted(self.products @ basis, self.shared @ basis)


class _Misfit:
    """The residual (N, M) less its fitted directions, and what statistics of it are made from: the
    untouched level (M,) of the simulation, the touch's signal (N, M) and its square a frame (N,).
    Readings that were lost are 0 throughout."""

    def __init__(
        self, recording: Recording, residual: np.ndarray, simulated: np.ndarray, fitted: np.ndarray
    ):
        self.recording = recording
        self.channels = recording.channels
        self.touch = recording.frames["touch"].to_numpy(bool)
        self.mask = np.isfinite(residual) & np.isfinite(simulated)
        self.count = np.maximum(self.mask.sum(axis=0), 1)
        self.is_difference = recording.metadata["values"] == "difference"
        shape = residual.shape
        self.simulated = np.where(self.mask, simulated, 0.0)
        columns = fitted.T.reshape(fitted.shape[1], *shape) * self.mask
        self.fitted = _orthonormal(self.centred(columns).reshape(len(columns), residual.size))
        flat = self.centred(np.where(self.mask, residual, 0.0)).ravel()
        flat = flat - (flat @ self.fitted.T) @ self.fitted
        self.residual, self.fitted = flat.reshape(shape), self.fitted.reshape(-1, *shape)
        untouched = self.mask & ~self.touch[:, None]
        count = np.maximum(untouched.sum(axis=0), 1)
        self.level = (self.simulated * untouched).sum(axis=0) / count
        signal = self.simulated - self.level
        self.signal = np.where(self.mask & self.touch[:, None], signal, 0.0)
        self.weight = (self.signal**2).sum(axis=1)
        unit = error_units(recording)[:, 0] if self.touch.any() else np.zeros(len(self.touch))
        signed = recording.metadata["voltage"] == "signed"
        self.odd = parity(self.channels, signed)[0]
        self.odd_of_signal = parity(self.channels, False)[0]
        self.unit_indicator = (np.unique(unit)[:, None] == unit).astype(float)

    @property
    def size(self) -> int:
        """Degrees of freedom of the residual."""
        constants = int(self.mask.any(axis=0).sum()) if self.is_difference else 0
        return int(self.mask.sum()) - len(self.fitted) - constants

    def centred(self, values: np.ndarray) -> np.ndarray:
        """(..., N, M) less each channel's mean, where only differences were recorded."""
        if not self.is_difference:
            return values
        return values - self.mask * (values.sum(axis=-2, keepdims=True) / self.count)

    def projections(self, laws: np.ndarray, field: np.ndarray | None = None) -> list[_Projection]:
        """One a column of laws (N, J), each channel of the field (N, M) times the law."""
        odd = self.odd if field is None else self.odd_of_signal  # the field has its sign already
        field = self.mask.astype(float) if field is None else field * self.mask
        scaled_residual = field * self.residual
        products = [(self.unit_indicator * law) @ scaled_residual for law in laws.T]
        shared = np.array([laws.T @ (field * column) for column in self.fitted])
        shared = shared.reshape(len(self.fitted), laws.shape[1], field.shape[1])
        length = (laws**2).T @ field**2
        if self.is_difference:
            centred = length - (laws.T @ field) ** 2 / self.count
            length = np.where(centred > FITTED_SHARE * length, centred, 0.0)
        return [
            _Projection(products[j], shared[:, j], length[j], odd) for j in range(laws.shape[1])
        ]


def _rows(misfit: _Misfit) -> Iterator[_Row]:
    constant, pressed = np.ones(len(misfit.touch)), misfit.touch.astype(float)
    overall, untouched, touched = misfit.projections(
        np.column_stack([constant, 1.0 - pressed, pressed])
    )
    (signal,) = misfit.projections(constant[:, None], misfit.signal)
    flat = misfit.residual.ravel()
    claim = "recording and simulation differ"
    yield _Row("everything", "", claim, float(flat @ flat), misfit.size)
    yield from _channel_rows("constant", "in every frame", overall, misfit)
    yield from _reciprocity_rows("untouched", "in the untouched frames", untouched, misfit)
    yield from _harmonic_rows("untouched", "untouched frames", untouched, misfit)
    if misfit.touch.any():
        yield from _reciprocity_rows("touched", "in the touched frames", touched, misfit)
        yield from _harmonic_rows("touched", "touched frames", touched, misfit)
        yield from _channel_rows("touch signal", "in the touch's signal", signal, misfit)
        yield from _reciprocity_rows("touch signal", "in the touch's signal", signal, misfit)
    yield from _law_rows(misfit)
    yield from _nearness_rows(misfit)
    yield from _scan_rows(misfit, overall)
    yield from _amplitude_rows(misfit)


def _channel_rows(
    statistic: str, extent: str, projection: _Projection, misfit: _Misfit
) -> Iterator[_Row]:
    """All channels, and those of each electrode, drive, measuring pair and separation."""
    count = len(misfit.channels)
    claim = f"channels differ from the simulation {extent}, each by its own amount"
    yield _Row(f"{statistic}: any channel", "", claim, *projection.explained(np.arange(count)))
    claim = f"all channels differ from the simulation {extent}, by one share"
    share = misfit.level[:, None] if statistic == "constant" else np.ones((count, 1))
    yield _Row(f"{statistic}: every channel", "", claim, *projection.explained(share))
    for kind, sites in _sites(misfit).items():
        for site, (name, channels) in sites.items():
            claim = f"{name} differs from the simulation {extent}"
            yield _Row(f"{statistic}: {kind}", site, claim, *projection.explained(channels))


def _sites(misfit: _Misfit) -> dict[str, dict[str, tuple[str, np.ndarray]]]:
    """For electrode, drive, measuring pair and separation: each site's name and channels.

    An electrode's contact bends the field of its neighbours' channels as well: with adjacent pairs
    the rows of the two electrodes beside it are as high.
    """
    channels = misfit.channels
    source, sink, plus, minus = channels.T
    separation = (plus - source) % misfit.recording.n_electrodes
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
            str(k): (
                f"what is measured {k} electrodes after the source",
                np.flatnonzero(separation == k),
            )
            for k in np.unique(separation)
        },
    }


def _electrodes(channels: np.ndarray) -> dict[str, tuple[str, np.ndarray]]:
    """Each electrode's name and the channels (k,) that drive or measure with it."""
    return {
        str(k): (f"electrode {k}", np.flatnonzero((channels == k).any(axis=1)))
        for k in np.unique(channels)
    }


def _reciprocity_rows(
    statistic: str, extent: str, projection: _Projection, misfit: _Misfit
) -> Iterator[_Row]:
    """Odd half and the rest; the touch's signal has its sign already."""
    signed = misfit.recording.metadata["voltage"] == "signed" and statistic != "touch signal"
    odd, even = parity(misfit.channels, signed)
    if not odd.shape[1]:
        return
    claim = f"exchanging drive and measurement changes the misfit {extent}, as no skin does"
    yield _Row(f"{statistic}: reciprocity", "odd", claim, *projection.explained(odd))
    claim = f"the misfit {extent} has a part that exchanging drive and measurement leaves alone"
    yield _Row(f"{statistic}: reciprocity", "even", claim, *projection.explained(even))


def _harmonic_rows(
    statistic: str, extent: str, projection: _Projection, misfit: _Misfit
) -> Iterator[_Row]:
    """Harmonics of the misfit's mean over the drive's place on the ring, every kind of channel (up
    to a rotation) with a cosine and a sine."""
    n = misfit.recording.n_electrodes
    kinds = _rotations(misfit.channels, n)
    if len(set(kinds)) == len(kinds):
        return
    kind = pd.factorize(pd.Series(kinds, dtype=object))[0]
    indicator = (kind[:, None] == np.arange(kind.max() + 1)).astype(float)
    for k in range(n // 2 + 1):
        angle = 2.0 * np.pi * k * misfit.channels[:, :1] / n
        waves = [indicator * np.cos(angle)]
        if 0 < 2 * k < n:
            waves.append(indicator * np.sin(angle))
        claim = f"the misfit of the {extent} goes {k} times up and down round the ring"
        if k == 0:
            claim = f"the {extent} have a misfit that is alike all round the ring"
        yield _Row(f"{statistic}: harmonic", str(k), claim, *projection.explained(np.hstack(waves)))


def _rotations(channels: np.ndarray, n_electrodes: int) -> list[tuple]:
    """What of each channel a rotation leaves: its electrodes counted from its source."""
    return [tuple(row) for row in ((channels - channels[:, :1]) % n_electrodes).tolist()]


def _law_rows(misfit: _Misfit) -> Iterator[_Row]:
    known_laws = list(laws(misfit.recording))
    if not known_laws:
        return
    frames = np.ones(len(misfit.touch))
    touched = misfit.touch.astype(float)
    constants = np.column_stack(
        [law.cleared(touched if _is_of_touches(law) else frames) for law in known_laws]
    )
    shares = np.column_stack([law.cleared(misfit.weight) for law in known_laws])
    rows = zip(
        known_laws,
        misfit.projections(constants),
        misfit.projections(shares, misfit.signal),
        strict=True,
    )
    electrodes = _electrodes(misfit.channels)
    for law, projection, share in rows:
        channels = np.arange(len(misfit.channels))
        claim = f"the misfit {law.phrase}"
        yield _Row(
            f"{law.statistic}: any channel", law.site, claim, *projection.explained(channels)
        )
        claim = f"a misfit in proportion to the untouched readings {law.phrase}"
        level = misfit.level[:, None]
        yield _Row(f"{law.statistic}: every reading", law.site, claim, *projection.explained(level))
        claim = f"the share by which the touch's signal is off {law.phrase}"
        profile = np.ones((len(misfit.channels), 1))
        yield _Row(f"{law.statistic}: touch signal", law.site, claim, *share.explained(profile))
        for site, (name, channels) in electrodes.items() if law.local else ():
            claim = f"the misfit at {name} {law.phrase}"
            yield _Row(f"{law.statistic}: electrode", site, claim, *projection.explained(channels))


def _is_of_touches(law: Law) -> bool:
    """Whether a law is about touched frames alone."""
    return law.touch and law.statistic != "touched"


def _nearness_rows(misfit: _Misfit) -> Iterator[_Row]:
    """Touches near an electrode, in all channels and in those of the electrode."""
    touch_nearness = nearness(misfit.recording)
    if touch_nearness is None or not misfit.touch.any():
        return
    # Less their weighted mean: what one share of all touches explains is no matter of place.
    mean = misfit.weight @ touch_nearness / max(misfit.weight.sum(), ZERO_LENGTH)
    projections = misfit.projections(touch_nearness - mean, misfit.signal)
    for site, (name, channels) in _electrodes(misfit.channels).items():
        profiles = np.ones((len(misfit.channels), 2))
        profiles[:, 1] = np.isin(np.arange(len(misfit.channels)), channels)
        claim = f"the share by which the touch's signal is off differs near {name}"
        yield _Row("position: electrode", site, claim, *projections[int(site)].explained(profiles))


def _scan_rows(misfit: _Misfit, overall: _Projection) -> Iterator[_Row]:
    """The order in which a frame's channels are read."""
    count = len(misfit.channels)
    place = np.linspace(-0.5, 0.5, count)[:, None]
    claim = "the misfit drifts along the scan of each frame"
    yield _Row("scan: position", "", claim, *overall.explained(place))
    claim = "the first channel of each frame differs from the simulation"
    yield _Row("scan: first channel", "0", claim, *overall.explained(np.array([0])))
    steps = np.diff(misfit.simulated, axis=1, prepend=misfit.simulated[:, :1])
    (carried_over,) = misfit.projections(np.ones((len(steps), 1)), -steps)
    claim = "the misfit goes with the step from the channel read before"
    yield _Row("scan: channel before", "", claim, *carried_over.explained(np.ones((count, 1))))
    if misfit.touch.any() and load_direction(misfit.recording).any():
        direction = load_direction(misfit.recording)[:, None]
        (skewed,) = misfit.projections(direction, misfit.signal)
        claim = "the touch's signal grows or shrinks along the scan while the force changes"
        yield _Row("scan: changing force", "", claim, *skewed.explained(place))


def _amplitude_rows(misfit: _Misfit) -> Iterator[_Row]:
    """Square and cube of the reading, beyond a constant and a share of it."""
    value = misfit.simulated / max(np.abs(misfit.simulated).max(), 1e-300)
    mask = misfit.mask
    basis = np.column_stack([np.ones(mask.sum()), value[mask]])
    for power, name in ((2, "square"), (3, "cube")):
        raised = value[mask] ** power
        field = np.zeros_like(value)
        field[mask] = raised - basis @ np.linalg.lstsq(basis, raised, rcond=None)[0]
        (projection,) = misfit.projections(np.ones((len(value), 1)), field)
        claim = f"the misfit goes with the {name} of the reading"
        profile = np.ones((value.shape[1], 1))
        yield _Row(f"amplitude: {name}", "", claim, *projection.explained(profile))


def _p_value(square: float, dof: int, noise_dof: float) -> float:
    """Of a squared length in noise units whose scale is known as well as noise_dof values tell."""
    if np.isinf(noise_dof):
        return float(chi2.sf(square, dof))
    return float(f.sf(square / dof, dof, noise_dof))


def _unfitted(products: np.ndarray, shared: np.ndarray) -> tuple[np.ndarray, int]:
    """(B, k) products of the residual in each unit of frames with orthonormal directions, less what
    fitted directions took of these, and the number of directions that are left.

    shared (P, k): with orthonormal fitted directions; one that is fitted counts as none.
    """
    if not products.shape[1]:
        return products, 0
    _, cosines, right_singular = np.linalg.svd(shared, full_matrices=False)
    free_share = 1.0 - cosines**2
    is_free = free_share > FITTED_SHARE
    scale = np.where(is_free, 1.0 / np.sqrt(np.where(is_free, free_share, 1.0)), 0.0)
    free_products = products + (products @ right_singular.T * (scale - 1.0)) @ right_singular
    return free_products, int(products.shape[1] - (~is_free).sum())


def repeat_p_value(products: np.ndarray) -> float:
    """P-value of the sum of products (B, k) with B units of frames, by their scatter alone; 1 where
    there is none of it.

    Where units are independent and their mean is 0, the squared length of the sum over that of
    the scatter about their mean is distributed as F, whatever their covariance is; its degrees of
    freedom are those of a covariance as uneven as theirs (Satterthwaite, Biometrics 2, 1946; Box,
    Ann. Math. Statist. 25, 1954).
    """
    products = products[(products != 0.0).any(axis=1)]
    count, size = products.shape
    if count < LEAST_UNITS:
        return 1.0
    mean, dof = products.mean(axis=0), count - 1
    gram = (products - mean) @ (products - mean).T
    trace, square = float(np.trace(gram)), float((gram**2).sum())
    if trace == 0.0:
        return 1.0
    uneven = max(square - trace**2 / dof, 0.0) / ((dof - 1) * (dof + 2))
    size = min(max(trace**2 / dof**2 / uneven, 1.0), size) if uneven > 0.0 else size
    ratio = count * float(mean @ mean) / (trace / dof)
    return float(f.sf(ratio, size, size * dof))


def _orthonormal(rows: np.ndarray) -> np.ndarray:
    """(R, K) orthonormal rows that span rows (P, K), K far above P: twice by the Gram matrix, since
    once loses as many digits as its condition has."""
    length = np.linalg.norm(rows, axis=1)
    rows = rows[length > 0.0] / length[length > 0.0, None]
    for _ in range(2):
        eigenvalues, mix = np.linalg.eigh(rows @ rows.T)
        independent = eigenvalues > DEPENDENT_SHARE * eigenvalues.max(initial=0.0)
        rows = (mix[:, independent] / np.sqrt(eigenvalues[independent])).T @ rows
    return rows


def _surprise(table: pd.DataFrame) -> np.ndarray:
    """(R,) how far each value is beyond its degrees of freedom, where p-values are all 0."""
    return ((table["value"] - table["dof"]) / np.sqrt(2.0 * table["dof"])).to_numpy()


def _sentence(claim: str, q: float) -> str:
    if q > DISCOVERY:
        return f"No evidence that {claim}."
    return f"{claim[0].upper()}{claim[1:]}."
