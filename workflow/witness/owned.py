"""Recordings like those of owners of tanks and skins, with known truth.

    draw("owner:static-body", 3), draw("owner:step", 600001)

Untouched bodies with electrodes over part of their height, outlines out of round, clipped channels,
steps in time, many electrodes and drives, wrong channel tables, incomplete nominal skins. Solved by
the boundary's integral equations (`world`); no line is shared with the diagnosis or its check.
Equal kinds and seeds give the same recording bit for bit.
"""

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from scipy.optimize import minimize_scalar

from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table, every_channel, undriven
from eitskin.physics.skin import Skin
from witness import rig_errors
from witness.cases import log_uniform, owners_metadata, signature
from witness.rig_errors import USUAL, RigError
from witness.schedule import Keep, query_frames, recording_frames, untouched_frames
from witness.world import World

LEVELS = (3e-4, 5e-3)  # range of the noise over the median |v|
FRAMES = (20, 60)  # of an untouched recording
MIN_SNR = 40.0  # of the concealed effects over all frames, reached by less noise where possible
MIN_STEP_SNR = 20.0  # of a step over one frame's noise, likewise
CONTACTS = (-3.0, 12.0)  # logarithm of an unknown contact impedivity over the true one
MILD = (0.1, 1.0)  # of the usual size of a rig's error
MILD_CORRELATION = (0.3, 0.9)
ERRORS = tuple(  # without magnitudes, which have no sign for `owner:polarity`
    kind for kind, usual in USUAL.items() if usual.target == "readings" and kind != "quadrature"
)
OUT_OF_ROUND = (0.03, 0.1)  # amplitude of the rim, over the radius
MIDDLE = (0.25, 0.75)  # of a recording: the range of a step's frame
DITHER = 0.1  # of the noise, added by a converter after its ceiling
TABLES = {  # electrodes, patterns of the drives, read in adjacent pairs
    "32 adjacent": (32, ("adjacent",)),
    "32 skip-4": (32, ("skip-4",)),
    "16 of four drives": (16, ("adjacent", "skip-1", "skip-2", "skip-4")),
    "16 adjacent and opposite": (16, ("adjacent", "opposite")),
}
UNKNOWN = (
    "radius_mm",
    "thickness_mm",
    "electrode_width_mm",
    "contact_impedivity_ohm_m2",
)


@dataclass(frozen=True)
class Truth:
    """The truth of a recording. effects: laws absent from the owner's simulation, in the
    configuration's form; wanted: names of those that a diagnosis must report, the others being
    optional; step: the first frame after one; ceiling_V: of the clipped channels; wrong: the fault
    of the channel table, in the check's word."""

    effects: list[dict] = field(default_factory=list)
    wanted: tuple[str, ...] = ()
    step: int | None = None
    ceiling_V: float | None = None
    wrong: str | None = None


@dataclass(frozen=True)
class Owned:
    """One recording with its truth.

    drawn: its description; clean, voltage (N, M) V: readings without and with noise; query: states
    after it with noisy readings (Q, M) V, None where it is untouched; true: the skin.
    """

    kind: str
    seed: int
    drawn: str
    truth: Truth
    true: Skin
    recorded: Recording
    query: Recording | None
    clean: np.ndarray
    level: float
    rig: tuple[RigError, ...]

    @property
    def voltage(self) -> np.ndarray:
        """Noisy readings (N, M) V."""
        return self.recorded.readings


@dataclass(frozen=True)
class _Plan:
    """A recording to be made: the true and the nominal skin, channels (M, 4), laws of the skin,
    those after a step, the truth; order (M,): the channel in each column; sign: of all readings;
    touched: whether the skin is pressed; room: the share of the radius for touches."""

    drawn: str
    true: Skin
    believed: Skin
    channels: np.ndarray
    laws: list[dict]
    truth: Truth
    touched: bool = False
    later: list[dict] | None = None
    order: np.ndarray | None = None
    sign: float = 1.0
    clipped: bool = False
    room: float = 1.0


def draw(kind: str, seed: int) -> Owned:
    """One recording. kind: owner: and a key of KINDS.

    static-body: pins, low strips or strips of full height in a tank; out-of-round: a tank of full
    strips, or a pressed sheet, whose rim keeps its length; clipped: driven channels stop at a
    ceiling; step: a contact or a gain changes at a frame; many-drives: of TABLES; order, polarity:
    a table that is wrong; beliefs: one to four of UNKNOWN are. Noise 0.03 to 0.5 % of the median
    |v|; half are recorded by a rig with one or two mild errors. Raises InputError for an unknown
    kind.
    """
    word, _, name = kind.partition(":")
    if word != "owner" or name not in KINDS:
        expected = f"owner: and one of {', '.join(KINDS)}"
        raise InputError("owned", "kind", repr(kind), expected)
    rng = np.random.default_rng([crc32(kind.encode()), seed])
    while True:
        owned = _recording_of(kind, seed, KINDS[name](rng), rng)
        if owned is not None:
            return owned


def _recording_of(kind: str, seed: int, plan: _Plan, rng: np.random.Generator) -> Owned | None:
    """The recording of a plan, None where its effects would be too weak."""
    frame_s = round(float(rng.uniform(0.2, 0.4)), 3)
    states, query = _frames(rng, plan, frame_s)
    world = World(plan.true, plan.channels, frame_s)
    clean = world.readings(states, plan.laws)
    truth = plan.truth
    level = log_uniform(rng, *LEVELS)
    noise = np.full(clean.shape[1], level * float(np.median(np.abs(clean[0]))))
    visibility = np.inf
    if plan.later is not None:
        readings_after = world.readings(states, plan.later)
        step = int(len(states) * rng.uniform(*MIDDLE))
        truth = replace(truth, step=step)
        visibility = float(
            np.linalg.norm((readings_after[step] - clean[step]) / noise) / MIN_STEP_SNR
        )
        clean = np.where(np.arange(len(states))[:, None] < step, clean, readings_after)
    elif plan.laws:
        visibility = (
            snr_beyond_sheet(plan.true, plan.believed, world, states, clean, noise) / MIN_SNR
        )
    noise_factor = min(1.0, max(visibility, LEVELS[0] / level))
    if visibility < noise_factor:
        return None
    level, noise = level * noise_factor, noise * noise_factor
    rig = _mild(rng) if rng.uniform() < 0.5 else ()
    readings_list = [rig_errors.read(clean, rig, states, noise, rng)]
    if query is not None:
        largest = float(states["force_N"].max())
        query_readings = world.readings(query, plan.later or plan.laws, None, largest)
        readings_list.append(query_readings + noise * rng.standard_normal(query_readings.shape))
    if plan.clipped:
        ceiling = _ceiling(rng, clean, plan.channels)
        limit = {"name": "adc-nonlinearity", "parameters": {"limit_V": ceiling}}
        truth = replace(truth, ceiling_V=ceiling, effects=[limit])
        dither = noise * (DITHER if rng.uniform() < 0.5 else 0.0)
        readings_list = [
            np.clip(readings_part, -ceiling, ceiling)
            + dither * rng.standard_normal(readings_part.shape)
            for readings_part in readings_list
        ]
    metadata = owners_metadata(plan.channels, frame_s, plan.believed)
    order = slice(None) if plan.order is None else plan.order
    recordings = [
        Recording(frames, plan.sign * readings_part[:, order], None, None, deepcopy(metadata))
        for frames, readings_part in zip((states, query), readings_list, strict=False)
    ]
    errors = [f"{error.kind} {error.size:.3g}" for error in rig]
    return Owned(
        kind,
        seed,
        "; ".join([plan.drawn, f"noise {level:.2g}", *errors]),
        truth,
        plan.true,
        recordings[0],
        recordings[1] if query is not None else None,
        clean,
        level,
        rig,
    )


def _frames(
    rng: np.random.Generator, plan: _Plan, frame_s: float
) -> tuple[pd.DataFrame, pd.DataFrame | None]:
    """The states of the recording and, where the skin is touched, of the query after it."""
    if not plan.touched:
        return untouched_frames(int(rng.integers(FRAMES[0], FRAMES[1] + 1)), 1.05 * frame_s), None
    assert plan.true.radius_mm is not None
    room = plan.room * plan.true.radius_mm
    states = recording_frames(rng, room, frame_s, Keep())
    return states, query_frames(rng, states, room, frame_s, Keep())


def snr_beyond_sheet(
    true: Skin,
    believed: Skin,
    world: World,
    states: pd.DataFrame,
    clean: np.ndarray,
    noise_V: np.ndarray,
) -> float:
    """The SNR over all frames of the misfit of the first, untouched frame of readings (N, M) V to
    the best sheet, fitted in its conductivity and, where unknown, its contact impedivity; noise_V
    (M,). A body with low electrodes may read like a sheet with worse contacts."""
    first_frame, impedivity = states.iloc[:1], true.contact_impedivity_ohm_m2
    assert impedivity is not None

    def remaining_snr(log_ratio: float) -> float:
        contact = impedivity * float(np.exp(log_ratio))
        sheet = World(replace(true, contact_impedivity_ohm_m2=contact), world.channels, 1.0)
        return signature(clean[:1], sheet.readings(first_frame, []), noise_V) * np.sqrt(len(clean))

    if believed.contact_impedivity_ohm_m2 is not None:
        return remaining_snr(0.0)
    return float(minimize_scalar(remaining_snr, bounds=CONTACTS, method="bounded").fun)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(f"{rng.uniform(low, high):.4g}")


def _mild(rng: np.random.Generator) -> tuple[RigError, ...]:
    """One or two errors of a rig's readings, none above its usual size."""
    kinds = rng.choice(ERRORS, int(rng.integers(1, 3)), replace=False).tolist()
    errors = []
    for kind in kinds:
        usual = USUAL[kind].size
        band = (MILD[0] * usual, MILD[1] * usual)
        size = log_uniform(rng, *(MILD_CORRELATION if kind == "correlated-noise" else band))
        errors.append(RigError(kind, size, int(rng.integers(2**31))))
    return tuple(errors)


def _ceiling(rng: np.random.Generator, clean: np.ndarray, channels: np.ndarray) -> float:
    """A ceiling, V, above all channels without a driven electrode and below all others, or below
    the driving pairs alone, whose readings are largest."""
    level, free = np.abs(clean).min(axis=0), undriven(channels)
    driving = (channels[:, :2] == channels[:, 2:]).all(axis=1)
    lowest_driven = level[driving if rng.uniform() < 0.5 else ~free].min()
    largest = float(np.abs(clean[:, free]).max())
    return float(f"{max(lowest_driven * rng.uniform(0.85, 0.98), 1.05 * largest):.4g}")


# ---- skins


def _angles(count: int) -> tuple[float, ...]:
    return tuple((360.0 / count * np.arange(count)).tolist())


def _sheet(rng: np.random.Generator) -> Skin:
    """A skin of 16 electrodes."""
    return Skin(
        radius_mm=_between(rng, 50.0, 90.0),
        thickness_mm=_between(rng, 2.0, 4.0),
        conductivity_S_per_m=_between(rng, 0.2, 1.0),
        electrode_deg=_angles(16),
        electrode_width_mm=_between(rng, 4.0, 9.0),
        contact_impedivity_ohm_m2=log_uniform(rng, 5e-4, 1e-2),
        current_A=log_uniform(rng, 1e-4, 5e-3),
        contrast_per_N=_between(rng, 0.2, 1.0),
    )


def _tank(rng: np.random.Generator, electrodes: str, count: int = 16) -> Skin:
    """A tank with pins (as high as wide), low strips, or full strips over its depth."""
    radius, depth = _between(rng, 60.0, 120.0), _between(rng, 10.0, 40.0)
    widest = 0.4 * 2.0 * np.pi * radius / count
    width = _between(rng, 4.0, min(10.0, widest))
    height = {
        "pins": min(max(width, depth / 8.0), 0.6 * depth),
        "low strips": depth * rng.uniform(0.3, 0.6),
        "full strips": depth,
    }[electrodes]
    height = float(f"{height:.4g}")
    return Skin(
        radius_mm=radius,
        thickness_mm=depth,
        conductivity_S_per_m=_between(rng, 0.1, 0.5),
        electrode_deg=_angles(count),
        electrode_width_mm=width,
        contact_impedivity_ohm_m2=log_uniform(rng, 5e-4, 1e-2),
        current_A=log_uniform(rng, 1e-4, 5e-3),
        contrast_per_N=0.0,
        electrode_height_mm=height,
        electrode_z_mm=0.5 * height + float(np.floor(1e3 * rng.uniform() * (depth - height)) / 1e3),
    )


def _as_known(rng: np.random.Generator, true: Skin) -> Skin:
    """The nominal skin: a conductivity up to 15 % off, no contrast of an untouched skin, and in
    half the cases no contact impedivity."""
    assert true.conductivity_S_per_m is not None
    conductivity = float(true.conductivity_S_per_m * (1.0 + rng.uniform(-0.15, 0.15)))
    skin = replace(
        true, conductivity_S_per_m=conductivity, contrast_per_N=true.contrast_per_N or None
    )
    unknown = rng.uniform() < 0.5
    return replace(skin, contact_impedivity_ohm_m2=None) if unknown else skin


def _depth(true: Skin, believed: Skin) -> dict:
    """The law third-dimension of a skin that is a body."""
    unknown = believed.thickness_mm is None
    parameters = {"depth_mm": true.thickness_mm} if unknown else {}
    return {"name": "third-dimension", "parameters": parameters}


def _solved(true: Skin, effects: list[dict]) -> list[dict]:
    """The laws with which the world solves a skin: with its depth, even if the nominal skin has
    none."""
    other_laws = [law for law in effects if law["name"] != "third-dimension"]
    return other_laws if len(other_laws) == len(effects) else [*other_laws, _depth(true, true)]


# ---- kinds


def _either_skin(rng: np.random.Generator) -> tuple[Skin, Skin, bool, str]:
    """The true and the nominal skin, whether it is touched, and its description: a pressed sheet,
    or a tank with strips of full height, for which the third dimension has no effect."""
    touched = bool(rng.uniform() < 0.5)
    true = _sheet(rng) if touched else _tank(rng, "full strips")
    words = "a sheet, pressed" if touched else "a tank with full strips"
    return true, _as_known(rng, true), touched, words


def _static_body(rng: np.random.Generator) -> _Plan:
    electrodes = str(rng.choice(["pins", "low strips", "full strips"], p=[0.5, 0.25, 0.25]))
    true = _tank(rng, electrodes)
    believed = _as_known(rng, true)
    unknown_count = int(rng.integers(3))
    if unknown_count:
        believed = replace(believed, electrode_height_mm=None, electrode_z_mm=None)
    if unknown_count == 2:
        believed = replace(believed, thickness_mm=None)
    knowledge = ("all said", "height of the electrodes not said", "depth and height not said")[
        unknown_count
    ]
    drawn = f"a tank with {electrodes}, {knowledge}"
    effects = [] if electrodes == "full strips" else [_depth(true, believed)]
    wanted = tuple(law["name"] for law in effects)
    laws, truth = _solved(true, effects), Truth(effects, wanted)
    return _Plan(drawn, true, believed, channel_table(16), laws, truth)


def _out_of_round(rng: np.random.Generator) -> _Plan:
    """An outline out of round, with electrode edges at fixed arc lengths of the rim. Untouched, a
    disc with other places, widths and contacts of electrodes reads the same (Riemann's map): then
    the outline must be among the alternatives."""
    true, believed, touched, words = _either_skin(rng)
    harmonic = int(rng.choice([2, 2, 3]))
    amplitude, phase = _between(rng, *OUT_OF_ROUND), _between(rng, 0.0, 360.0)
    shape = {"harmonic": harmonic, "amplitude": amplitude, "phase_deg": phase}
    assert true.electrode_width_mm is not None and true.electrode_deg is not None
    assert true.radius_mm is not None
    half = np.degrees(0.5 * true.electrode_width_mm / true.radius_mm)
    edges = np.add.outer([-half, half], true.electrode_deg)
    shift = np.reshape(carried(edges.ravel().tolist(), harmonic, amplitude, phase), edges.shape)
    width = np.radians(2.0 * half + shift[1] - shift[0]) * true.radius_mm
    seats = (
        ("electrode-position", "shift_deg", shift.mean(axis=0)),
        ("electrode-width", "width_mm", width),
    )
    effects: list[dict[str, Any]] = [{"name": "domain-shape", "parameters": shape}]
    effects += [
        {
            "name": name,
            "electrodes": list(range(16)),
            "parameters": {key: np.round(value, 5).tolist()},
        }
        for name, key, value in seats
    ]
    drawn = f"{words}, out of round by {amplitude:.3g} in harmonic {harmonic}"
    truth = Truth(effects, ("domain-shape",))
    room = 1.0 - amplitude
    return _Plan(drawn, true, believed, channel_table(16), effects, truth, touched, room=room)


def carried(deg: Sequence[float], harmonic: int, amplitude: float, phase_deg: float) -> list:
    """The shifts, degrees, with mean 0, of marks at `deg` at fixed arc lengths of a rim deformed
    without stretching to r = 1 + amplitude cos(harmonic phi - phase).

    To first order -amplitude / harmonic sin(harmonic phi - phase); here from the arc length.
    """
    phi = np.linspace(-2.0 * np.pi, 4.0 * np.pi, 60_001)
    turn = harmonic * phi - np.radians(phase_deg)
    speed = np.hypot(1.0 + amplitude * np.cos(turn), harmonic * amplitude * np.sin(turn))
    length = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(phi)))
    rim_length = length[40_000] - length[20_000]
    start, angle = length[20_000], np.radians(deg)
    for _ in range(20):
        shift = np.interp(start + rim_length * angle / (2.0 * np.pi), length, phi) - angle
        start -= shift.mean() * rim_length / (2.0 * np.pi)
    return np.round(np.degrees(shift), 4).tolist()


def _clipped(rng: np.random.Generator) -> _Plan:
    true, believed, touched, words = _either_skin(rng)
    channels = every_channel(16, "adjacent", "adjacent")
    drawn = f"{words}, driven channels clipped"
    return _Plan(drawn, true, believed, channels, [], Truth(), touched, clipped=True)


def _fault(rng: np.random.Generator, count: int) -> dict:
    """A clear fault of a contact, an amplifier or a source at one place."""
    site = int(rng.integers(count))
    factor = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.25))
    return [
        {
            "name": "contact-impedance",
            "electrodes": [site],
            "parameters": {"ratio": [log_uniform(rng, 5.0, 30.0)]},
        },
        {
            "name": "measurement-gain",
            "measures": [site],
            "parameters": {"gain": [float(f"{1.0 + factor:.4g}")]},
        },
        {
            "name": "drive-gain",
            "drives": [site],
            "parameters": {"gain": [float(f"{1.0 + factor:.4g}")]},
        },
    ][int(rng.integers(3))]


def _step(rng: np.random.Generator) -> _Plan:
    true, believed, touched, words = _either_skin(rng)
    fault = _fault(rng, 16)
    if rng.uniform() < 0.25:
        gain = _between(rng, 0.9, 0.98) ** float(rng.choice([-1.0, 1.0]))
        fault = {
            "name": "drive-gain",
            "drives": list(range(16)),
            "parameters": {"gain": [gain] * 16},
        }
    drawn = f"{words}, a step of {_words(fault)}"
    truth = Truth([fault])
    return _Plan(drawn, true, believed, channel_table(16), [], truth, touched, [fault])


def _words(law: dict) -> str:
    sites = next(law[kind] for kind in ("electrodes", "measures", "drives") if kind in law)
    place_text = "all" if len(sites) > 1 else str(sites[0])
    (values,) = law["parameters"].values()
    return f"{law['name']} {values[0]:.3g} at {place_text}"


def _many_drives(rng: np.random.Generator) -> _Plan:
    table = str(rng.choice(list(TABLES)))
    count, patterns = TABLES[table]
    channels = np.concatenate([channel_table(count, drive) for drive in patterns])
    electrodes = str(rng.choice(["low strips", "full strips"]))
    true = _tank(rng, electrodes, count)
    believed = _as_known(rng, true)
    effects, effect_text = [], "sound"
    if electrodes == "low strips":
        effects, effect_text = [_depth(true, believed)], "nothing else"
    elif rng.uniform() < 0.5:
        effects = [_fault(rng, count)]
        effect_text = _words(effects[0])
    drawn = f"{table}, {electrodes}, {effect_text}"
    truth = Truth(effects, tuple(law["name"] for law in effects))
    return _Plan(drawn, true, believed, channels, _solved(true, effects), truth)


def _order(rng: np.random.Generator) -> _Plan:
    true, believed, touched, words = _either_skin(rng)
    channels = channel_table(16)
    way = list(ORDERS)[int(rng.integers(len(ORDERS)))]
    truth, drawn, order = Truth(wrong="order"), f"{words}, {way}", ORDERS[way](channels)
    return _Plan(drawn, true, believed, channels, [], truth, touched, order=order)


def _from_drive(channels: np.ndarray) -> np.ndarray:
    return np.lexsort(((channels[:, 2] - channels[:, 0]) % 16, channels[:, 0]))


def _by_pair(channels: np.ndarray) -> np.ndarray:
    return np.lexsort((channels[:, 0], channels[:, 2]))


def _backwards(channels: np.ndarray) -> np.ndarray:
    return np.lexsort((-channels[:, 2], channels[:, 0]))


ORDERS: dict[str, Callable[[np.ndarray], np.ndarray]] = {  # channel in each column
    "pairs from the drive's own on": _from_drive,
    "pair by pair": _by_pair,
    "pairs backwards": _backwards,
}


def _polarity(rng: np.random.Generator) -> _Plan:
    true, believed, touched, words = _either_skin(rng)
    truth, drawn = Truth(wrong="polarity"), f"{words}, plus and minus exchanged"
    return _Plan(drawn, true, believed, channel_table(16), [], truth, touched, sign=-1.0)


def _beliefs(rng: np.random.Generator) -> _Plan:
    true, believed, touched, words = _either_skin(rng)
    keys = rng.choice(UNKNOWN, int(rng.integers(1, len(UNKNOWN) + 1)), replace=False).tolist()
    believed = replace(believed, **dict.fromkeys(keys))
    effects = [_fault(rng, 16)] if rng.uniform() < 0.5 else []
    drawn = f"{words}, {', '.join(map(_words, effects)) or 'sound'}; unknown: {', '.join(keys)}"
    truth = Truth(effects, tuple(law["name"] for law in effects))
    return _Plan(drawn, true, believed, channel_table(16), effects, truth, touched)


KINDS: dict[str, Callable[[np.random.Generator], _Plan]] = {
    "static-body": _static_body,
    "out-of-round": _out_of_round,
    "clipped": _clipped,
    "step": _step,
    "many-drives": _many_drives,
    "order": _order,
    "polarity": _polarity,
    "beliefs": _beliefs,
}
