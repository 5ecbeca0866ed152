"""An untouched skin or tank explained by its geometry, judged on reciprocal pairs left out.

Half of the reciprocal pairs, drawn at random, fit scale and geometry; the others are predicted.
Geometries differ in what they know: points; a sheet, electrodes as wide as the drawing has them or
free up to half the pitch; a sheet with any width; a body with a depth. Electrodes are evenly round
and alike, so all leave at least the floor: what the mean over rotations at fixed separation leaves.
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics.forward import channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import reciprocal_channels
from eitskin.physics.skin import Skin
from eitskin.physics.solver import forward_model

SPLITS = 20
WIDEST = 0.5  # of the pitch: an electrode that is physical
TOUCHING = 0.98  # of the pitch
# Over the radius, or the pitch for a width and the depth for a height: least, start, most.
BOUNDS = {
    "electrode_width_mm": (0.02, 0.3, WIDEST),
    "depth_mm": (0.05, 0.6, 2.0),
    "electrode_height_mm": (0.05, 0.3, 1.0),
    "contact_mm": (1e-2, 3e-2, 0.3),
}
SHEET_CONTACT = (1e-4, 0.1, 10.0)  # the whole range: a body's smaller contacts are slow to solve
ROUNDS = 30
REFITS = 6  # evaluations of a fit to one split, begun at that to all pairs


@dataclass(frozen=True)
class Geometries:
    """A family of geometries: its name, whether electrodes are points, wider than is physical, and
    whether the skin is a body."""

    name: str
    points: bool = False
    any_width: bool = False
    body: bool = False


FAMILIES = (
    Geometries("points", points=True),
    Geometries("sheet"),
    Geometries("sheet of any width", any_width=True),
    Geometries("body", body=True),
)


@dataclass(frozen=True)
class Untouched:
    """|v| (M,) of an untouched skin, mean over its frames, of the modulus where there is a
    quadrature; channels (M, 4); reciprocal pairs (P, 2); the skin as its owner believes it."""

    reading: np.ndarray
    channels: np.ndarray
    pairs: np.ndarray
    skin: Skin
    n_electrodes: int

    @classmethod
    def of(cls, recording: Recording) -> "Untouched":
        """Of a recording; InputError where it has no untouched frame or no reciprocal pairs."""
        untouched = ~recording.frames["touch"].to_numpy(bool)
        if not untouched.any() or recording.metadata["values"] == "difference":
            raise InputError("recording", "frames", "no untouched frame", "an absolute one")
        values = recording.readings[untouched]
        if recording.quadrature is not None:
            values = np.hypot(values, recording.quadrature[untouched])
        reading = np.abs(values).mean(axis=0)
        pairs, _ = reciprocal_channels(recording.channels)
        read = np.isfinite(reading[pairs]).all(axis=1) if len(pairs) else np.zeros(0, bool)
        if read.sum() < 2 * len(BOUNDS):
            number = f"{read.sum()} reciprocal pairs read"
            raise InputError("recording", "channels", number, f"{2 * len(BOUNDS)} or more")
        return cls(reading, recording.channels, pairs[read], recording.skin, recording.n_electrodes)

    @property
    def separation(self) -> np.ndarray:
        """(M,): what channels that a rotation, a reflection or reciprocity makes equal share."""
        n = self.n_electrodes
        kinds: dict[tuple, int] = {}
        label = []
        for source, sink, plus, minus in self.channels.tolist():
            forms = []
            for (a, b), (c, d) in itertools.product(
                ((source, sink), (sink, source)), ((plus, minus), (minus, plus))
            ):
                for sign in (1, -1):
                    forms.append(tuple(sign * (e - a) % n for e in (b, c, d)))
                    forms.append(tuple(sign * (e - c) % n for e in (d, a, b)))
            label.append(kinds.setdefault(min(forms), len(kinds)))
        return np.array(label)


class Family:
    """One family of geometries for one untouched skin, by the logarithms of what is free."""

    def __init__(self, untouched: Untouched, family: Geometries):
        skin = untouched.skin
        self.untouched, self.family = untouched, family
        self.radius = skin.radius_mm or 100.0  # only ratios are seen
        self.pitch = 2.0 * np.pi * self.radius / untouched.n_electrodes
        self.bounds = {}
        if family.points:
            return
        wide = skin.electrode_width_mm is None or family.any_width
        keys = [*(["electrode_width_mm"] if wide else []), "contact_mm"]
        if family.body:
            keys += ["depth_mm"] if skin.thickness_mm is None else []
            keys += ["electrode_height_mm"] if skin.electrode_height_mm is None else []
        self.bounds = {key: BOUNDS[key] for key in keys}
        if not family.body:
            self.bounds["contact_mm"] = SHEET_CONTACT
        if family.any_width:
            low, start, _ = BOUNDS["electrode_width_mm"]
            self.bounds["electrode_width_mm"] = (low, start, TOUCHING)

    def values(self, theta: np.ndarray) -> dict[str, float]:
        """What is free, at its logarithms (P,), in mm."""
        unit = {"electrode_width_mm": self.pitch}
        sizes = {
            key: float(np.exp(logarithm)) * unit.get(key, self.radius)
            for key, logarithm in zip(self.bounds, theta, strict=True)
        }
        if "electrode_height_mm" in sizes:
            depth = sizes.get("depth_mm", self.untouched.skin.thickness_mm)
            assert depth is not None
            sizes["electrode_height_mm"] *= depth / self.radius
        return sizes

    def reading(self, theta: np.ndarray, accuracy: str) -> np.ndarray:
        """(M,): |v| up to a factor."""
        skin, values, n = self.untouched.skin, self.values(theta), self.untouched.n_electrodes
        angles = skin.electrode_deg or tuple(np.arange(n) * 360.0 / n)
        width = values.get("electrode_width_mm", skin.electrode_width_mm)
        geometry = Geometry(
            self.radius,
            values.get("depth_mm", skin.thickness_mm) or self.radius,
            1.0,
            np.array(angles),
            np.array(0.0 if self.family.points else width),
            np.array(1e-3 * values.get("contact_mm", 0.0)),
            electrode_height_mm=values.get("electrode_height_mm", skin.electrode_height_mm),
            electrode_z_mm=skin.electrode_z_mm,
            deep=self.family.body,
        )
        impedance = forward_model(geometry, accuracy).transfer_impedance()
        return np.abs(channel_values(impedance, self.untouched.channels))

    def fit(
        self, fitted: np.ndarray, start: np.ndarray | None = None, slope: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms (P,) that fit channels `kept` best, one common factor free, and their
        residual's slope (M, P); with `slope` given, its own is never taken anew."""
        if not self.bounds:
            return np.zeros(0), np.zeros((len(fitted), 0))
        low, typical, high = np.log(np.array(list(self.bounds.values())).T)
        recorded = self.untouched.reading
        unit = np.linalg.norm(recorded)

        def residual(theta: np.ndarray) -> np.ndarray:
            model = self.reading(theta, "train")
            return (recorded - _factor(model, recorded, fitted) * model) * fitted / unit

        starts = [typical] if start is None else [np.clip(start, low + 1e-6, high - 1e-6)]
        if start is None and self.family.any_width:  # good contacts are a minimum of their own
            starts.append(np.r_[high[0] - 0.1, low[1] + 1.0])
        runs = [
            least_squares(
                residual,
                guess,
                "3-point" if slope is None else lambda theta: slope * fitted[:, None],
                (low, high),
                diff_step=1e-2 if slope is None else None,
                max_nfev=ROUNDS if slope is None else REFITS,
                xtol=1e-3,
                ftol=1e-4,
            )
            for guess in starts
        ]
        best = min(runs, key=lambda run: run.cost)
        return best.x, best.jac


def without_drawing(recording: Recording) -> Recording:
    """The recording of an owner who knows no size of the electrodes and no depth."""
    sizes = dict.fromkeys(("thickness_mm", "electrode_width_mm"))
    skin = {k: v for k, v in recording.metadata["skin"].items() if k != "electrode_height_mm"}
    return replace(recording, metadata=recording.metadata | {"skin": skin | sizes})


def _factor(model: np.ndarray, recorded: np.ndarray, fitted: np.ndarray) -> float:
    return float(model[fitted] @ recorded[fitted] / (model[fitted] @ model[fitted]))


def relative_residual(recorded: np.ndarray, model: np.ndarray) -> float:
    """|recorded - model| over |recorded|, both (M,)."""
    return float(np.linalg.norm(recorded - model) / np.linalg.norm(recorded))


def splits(pairs: int, count: int, seed: int) -> np.ndarray:
    """(count, pairs) bool: which half of the pairs is held out."""
    rng = np.random.default_rng(seed)
    half = np.arange(pairs) < pairs // 2
    return np.array([rng.permutation(half) for _ in range(count)])


def floor(untouched: Untouched, fitted: np.ndarray, held_out: np.ndarray) -> float:
    """Relative residual on channels `judged` of the mean of channels `fitted` (both bool (M,)) that
    a rotation, a reflection or reciprocity makes equal."""
    label, recorded = untouched.separation, untouched.reading
    total = np.bincount(label, recorded * fitted)
    mean = total / np.maximum(np.bincount(label, fitted.astype(float)), 1.0)
    return relative_residual(recorded[held_out], mean[label][held_out])


def judge(recording: Recording, seed: int = 1, count: int = SPLITS) -> pd.DataFrame:
    """Every family on `count` splits: one row a family, then the floor.

    geometry; free: what is fitted, with its value on all pairs; held_out: median relative residual
    on the pairs left out, low and high the 5 % and 95 % quantiles over splits; all: of a fit to all
    pairs; physical: no electrode is wider than half the pitch. InputError as `Untouched.of`.
    """
    untouched = Untouched.of(recording)
    held_out_pairs = splits(len(untouched.pairs), count, seed)
    all_pairs = np.zeros(len(untouched.reading), bool)
    all_pairs[untouched.pairs] = True
    held_out_masks = np.zeros((count, len(all_pairs)), bool)
    for split, held_out in zip(held_out_pairs, held_out_masks, strict=True):
        held_out[untouched.pairs[split]] = True
    rows = []
    for family in FAMILIES:
        member = Family(untouched, family)
        best, slope = member.fit(all_pairs)
        residuals = [
            _held_out(member, all_pairs & ~held_out, held_out, best, slope)
            for held_out in held_out_masks
        ]
        model = member.reading(best, "diagnose")
        model = model * _factor(model, untouched.reading, all_pairs)
        values = member.values(best)
        width = values.get("electrode_width_mm", untouched.skin.electrode_width_mm or 0.0)
        rows.append(
            {
                "geometry": family.name,
                "free": "; ".join(f"{key} {value:.3g}" for key, value in values.items()),
                **_quantiles(residuals),
                "all": relative_residual(untouched.reading[all_pairs], model[all_pairs]),
                "physical": family.points or width <= WIDEST * member.pitch * (1.0 + 1e-9),
            }
        )
    residuals = [floor(untouched, all_pairs & ~held_out, held_out) for held_out in held_out_masks]
    rows.append(
        {
            "geometry": "floor",
            "free": f"{untouched.separation.max() + 1} means over rotations",
            **_quantiles(residuals),
            "all": floor(untouched, all_pairs, all_pairs),
            "physical": True,
        }
    )
    return pd.DataFrame(rows)


def _held_out(
    member: Family, fitted: np.ndarray, held_out: np.ndarray, start: np.ndarray, slope: np.ndarray
) -> float:
    recorded = member.untouched.reading
    model = member.reading(member.fit(fitted, start, slope)[0], "train")
    return relative_residual(recorded[held_out], _factor(model, recorded, fitted) * model[held_out])


def _quantiles(residuals: list[float]) -> dict[str, float]:
    low, middle, high = np.quantile(residuals, [0.05, 0.5, 0.95])
    return {"held_out": middle, "low": low, "high": high}


def sentence(table: pd.DataFrame) -> str:
    """What `judge` found, for a person: a sheet, a third dimension, or that they look alike."""
    rows = table.set_index("geometry")
    sheet, wide, body = (rows.loc[name] for name in ("sheet", "sheet of any width", "body"))
    numbers = (
        f"On pairs left out a sheet leaves {sheet.held_out:.3f}, one of any electrode width "
        f"{wide.held_out:.3f}, a body {body.held_out:.3f}, the mean over rotations "
        f"{rows.loc['floor'].held_out:.3f}."
    )
    has_width = "electrode_width_mm" not in sheet.free
    if sheet.low <= body.held_out:
        finding = "A sheet with electrodes that are possible does as well."
    elif has_width or wide.low > body.high:
        reason = "the drawing's electrodes" if has_width else "any width of the electrodes"
        finding = f"third-dimension: no sheet with {reason} does as well."
    else:
        finding = (
            "third-dimension or electrode-width, which these readings cannot tell apart; the sizes "
            "of the electrodes would."
        )
    return f"{finding} {numbers}"
