"""Recordings whose right diagnosis is silence, a stretch of frames, or one number.

    draw("control:white-0.1", 500001), draw("control:averaged-frames", 3),
    draw("control:common-place", 1, generator="disc")

Nulls of white noise alone; one untouched frame, or the mean of some; presses without their label;
places, forces and times that are all off alike, on rigs with errors in forms of `alien_errors`;
pairs of effects far above the noise. Equal kinds, seeds and generators give the same recording bit
for bit.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from zlib import crc32

import numpy as np
import pandas as pd

from eitskin.data.recording import Recording
from eitskin.errors import InputError
from witness import alien_errors, cases
from witness.alien_errors import FORMS, OPEN, AlienError
from witness.cases import ALIEN_LEVELS, Case, log_uniform, names_of, signature
from witness.rig_errors import MAX_KINDS
from witness.schedule import REACH

WHITE_PERCENT = ("0.01", "0.03", "0.1", "0.3", "1")  # noise of nulls, of the median |v|
AVERAGED = (2, 100)  # frames in a mean
MIXED = (0.2, 0.8)  # share of the noise that is in proportion to the reading, where both are
COMMON = (0.2, 10.0)  # common part over the rig's own error of a press
DELAYS_S = (0.05, 0.5)
SLIDES_MM = (3.0, 6.0)  # way of a touch in one press, by which a delay of the pose shows
STRONG_SNR = (400.0, 1500.0)  # of each effect of a pair


@dataclass(frozen=True)
class Common:
    """What all presses share of an error. name: the effect that it is, None of the catalogue;
    parameters: its true values by the effect's keys, mm, N, 1 or s; own: rms over presses of the
    mean error that the rig has beside it, in that unit, of a delay over the rate at which place or
    force change; presses: their number; snr: of the common part in the white noise."""

    name: str | None
    parameters: dict[str, float]
    own: float
    presses: int
    snr: float


@dataclass(frozen=True)
class Stretch:
    """The frames of a press that nobody labelled: numbers of the first and the last, and the SNR
    of the touch in each, in the white noise."""

    first: int
    last: int
    snr: tuple[float, ...]


@dataclass(frozen=True)
class Control:
    """One recording with its truth.

    effects, scopes, snr, level, rig: as of a `Case`; generator: the solver; common, unlabelled: of
    the kinds that have them; averaged: number of frames in each of the recording's.
    """

    kind: str
    seed: int
    recorded: Recording
    generator: str
    level: float
    effects: list[dict]
    scopes: list[str]
    snr: list[float]
    rig: tuple[AlienError, ...] = ()
    common: Common | None = None
    unlabelled: tuple[Stretch, ...] = ()
    averaged: int = 1


def draw(kind: str, seed: int, generator: str = "boundary") -> Control:
    """One recording. kind: control: and a key of KINDS.

    white-PERCENT: a null of that noise over the median |v|; single-frame, averaged-frames: an
    untouched frame, or the mean of 2 to 100, noise alike in all channels, in proportion to the
    readings, or both; unlabelled-white, unlabelled-alien: a null of which one press or two say no
    touch; common-place, -force-zero, -force-factor: all touches off alike, by 0.2 to 10 times the
    rig's own error of a press; delay-force, delay-pose: reports of 0.05 to 0.5 s ago, poses of
    touches that slide; strong-pair: two effects of SNR 400 to 1,500. Noise 0.01 to 1 % of the
    median |v|. Raises InputError for an unknown kind, or one that the generator cannot solve.
    """
    word, _, name = kind.partition(":")
    if word != "control" or name not in KINDS:
        expected = f"control: and one of {', '.join(KINDS)}"
        raise InputError("controls", "kind", repr(kind), expected)
    rng = np.random.default_rng([crc32(f"{kind}, control".encode()), seed])
    return KINDS[name](kind, seed, generator, rng)


def _control(case: Case, recorded: Recording) -> Control:
    """A case as it is recorded."""
    forms = tuple(error for error in case.rig if isinstance(error, AlienError))
    name = case.world.generator.name
    known = (case.level, case.effects, case.scopes, case.snr, forms)
    return Control(case.kind, case.seed, recorded, name, *known)


def _white(percent: str, kind: str, seed: int, generator: str, rng: np.random.Generator) -> Control:
    level = 1e-2 * float(percent)
    case = cases.draw(kind, seed, names=[], generator=generator, levels=(level, level))
    return _control(case, case.recorded)


def _few_frames(
    averaged: bool, kind: str, seed: int, generator: str, rng: np.random.Generator
) -> Control:
    """One untouched frame, the mean of one or of many."""
    case = cases.draw(kind, seed, frames=12, names=[], generator=generator, levels=ALIEN_LEVELS)
    low, high = np.log(AVERAGED)
    number = round(float(np.exp(rng.uniform(low, high)))) if averaged else 1
    in_proportion = float(rng.choice([0.0, 1.0, rng.uniform(*MIXED)]))
    clean = case.clean[:1]
    size = np.abs(clean[0])
    noise = case.level * ((1.0 - in_proportion) * np.median(size) + in_proportion * size)
    voltage = clean + noise / np.sqrt(number) * rng.standard_normal(clean.shape)
    recorded = Recording(case.states.iloc[:1], voltage, None, None, dict(case.metadata))
    return replace(_control(case, recorded), averaged=number)


def _unlabelled(
    rig: str, kind: str, seed: int, generator: str, rng: np.random.Generator
) -> Control:
    """A null whose states say of one press or two that nobody touches."""
    null = cases.draw(kind, seed, names=[], generator=generator, levels=ALIEN_LEVELS)
    case = replace(cases.again(null, rig, 0), kind=kind)
    press = case.states["contact"]
    silent = rng.choice(press.dropna().unique(), int(rng.integers(1, 3)), replace=False)
    snr = np.linalg.norm((case.clean - case.clean[0]) / case.noise_V, axis=1)
    stretches = []
    for label in sorted(silent):
        rows = np.flatnonzero(press.isin([label]))
        number = case.states["frame"].to_numpy()[rows]
        stretches.append(Stretch(int(number[0]), int(number[-1]), tuple(snr[rows].tolist())))
    states = case.states.copy()
    is_silent = press.isin(silent).to_numpy(bool)
    states.loc[is_silent, "touch"] = False
    states.loc[is_silent, "force_N"] = 0.0
    states.loc[is_silent, ["x_mm", "y_mm", "probe_mm"]] = np.nan
    states.loc[is_silent, "contact"] = pd.NA
    recorded = Recording(states, case.voltage, None, None, dict(case.metadata))
    return replace(_control(case, recorded), unlabelled=tuple(stretches))


def _strong_pair(kind: str, seed: int, generator: str, rng: np.random.Generator) -> Control:
    while True:
        names, _ = names_of("pair", rng, generator)
        case = cases.draw(
            kind, seed, names=names, generator=generator, levels=ALIEN_LEVELS, snr=STRONG_SNR
        )
        if all(STRONG_SNR[0] <= snr <= STRONG_SNR[1] for snr in case.snr):
            return _control(case, case.recorded)


# ---- common parts


@dataclass(frozen=True)
class _Shift:
    """A common part as it is drawn: reported: the states that say it, without the rig's own errors;
    true: the states of the skin; laws: by which those differ, where the catalogue has them; name
    and parameters as of `Common`."""

    reported: pd.DataFrame
    true: pd.DataFrame
    laws: list[dict]
    name: str | None
    parameters: dict[str, float]


def _place_error(states: pd.DataFrame, reported: pd.DataFrame) -> float:
    """rms over presses and axes of the mean error of place, mm."""
    keys = ["x_mm", "y_mm"]
    error = (reported[keys] - states[keys]).groupby(states["contact"]).mean()
    return float(np.sqrt((error.to_numpy() ** 2).mean()))


def _force_error(states: pd.DataFrame, reported: pd.DataFrame) -> float:
    """rms over presses of the mean error of force, N."""
    error = (reported["force_N"] - states["force_N"]).groupby(states["contact"]).mean()
    return float(np.sqrt((error**2).mean()))


def _factor_error(states: pd.DataFrame, reported: pd.DataFrame) -> float:
    """rms over presses of the error of the mean force, over it."""
    mean = [table["force_N"].groupby(states["contact"]).mean() for table in (states, reported)]
    return float(np.sqrt(((mean[1] / mean[0] - 1.0) ** 2).mean()))


def _rate(states: pd.DataFrame, keys: Sequence[str]) -> float:
    """rms change a second of columns of the states, within presses."""
    step = states.groupby("contact")[["time_s", *keys]].diff().dropna()
    return float(np.sqrt((step[list(keys)].div(step["time_s"], axis=0).to_numpy() ** 2).mean()))


def _towards_centre(case: Case, way_mm: float) -> pd.DataFrame:
    """The states with their places drawn in, so that each stays on the skin all that way."""
    states = case.true_states.copy()
    assert case.true.radius_mm is not None
    room = REACH * case.true.radius_mm - 0.5 * float(states["probe_mm"].max())
    states[["x_mm", "y_mm"]] *= 1.0 - way_mm / room
    return states


def _law(states: pd.DataFrame, name: str, **parameters: float) -> _Shift:
    return _Shift(states, states, [{"name": name, "parameters": parameters}], name, parameters)


def _place_shift(rng: np.random.Generator, case: Case, amount: float) -> _Shift:
    """All touches off by a vector."""
    phi = rng.uniform(0.0, 2.0 * np.pi)
    x, y = (round(float(amount * part), 4) for part in (np.cos(phi), np.sin(phi)))
    shift = _law(_towards_centre(case, amount), "registration", dx_mm=x, dy_mm=y, rotation_deg=0.0)
    return replace(shift, parameters={"dx_mm": x, "dy_mm": y})


def _zero_shift(rng: np.random.Generator, case: Case, amount: float) -> _Shift:
    """A load cell whose zero is off; all that it reports stays above 0."""
    states = case.true_states.copy()
    offset = round(float(amount * rng.choice([-1.0, 1.0])), 4)
    if offset < 0.0:
        states.loc[states["touch"], "force_N"] -= offset
    return _law(states, "force-offset", offset_N=offset)


def _factor_shift(rng: np.random.Generator, case: Case, amount: float) -> _Shift:
    """A load cell that reports too much or too little by a factor."""
    ratio = float(f"{np.exp(amount * rng.choice([-1.0, 1.0])):.5g}")
    return _law(case.true_states, "touch-contrast", ratio=ratio)


def _force_delay(rng: np.random.Generator, case: Case, amount: float) -> _Shift:
    return _law(case.true_states, "force-lag", lag_s=amount)


def _pose_delay(rng: np.random.Generator, case: Case, amount: float) -> _Shift:
    """Touches that slide at a speed of their own, and poses of so long ago."""
    true = _towards_centre(case, SLIDES_MM[1])
    reported = true.copy()
    for _, press in true.groupby("contact"):
        way, phi = rng.uniform(*SLIDES_MM), rng.uniform(0.0, 2.0 * np.pi)
        since = press["time_s"].to_numpy() - press["time_s"].mean()
        for key, part in (("x_mm", np.cos(phi)), ("y_mm", np.sin(phi))):
            speed = way * part / np.ptp(since)
            true.loc[press.index, key] += speed * since
            reported.loc[press.index, key] += speed * (since - amount)
    return _Shift(reported, true, [], None, {"delay_s": amount})


@dataclass(frozen=True)
class _Quantity:
    """What a common part is of. on: of which keys of `alien_errors.ON` the rig's own error is;
    shift: makes a common part of an amount; error: the rig's own, of states and reported ones;
    largest: amount, in its unit; of a factor its logarithm; delayed: of a delay the columns of the
    states that it delays."""

    on: tuple[str, ...]
    shift: Callable[[np.random.Generator, Case, float], _Shift]
    error: Callable[[pd.DataFrame, pd.DataFrame], float]
    largest: float = np.inf
    delayed: tuple[str, ...] = ()


QUANTITIES = {
    "common-place": _Quantity(("place",), _place_shift, _place_error, 10.0),
    "common-force-zero": _Quantity(("force",), _zero_shift, _force_error, 3.0),
    "common-force-factor": _Quantity(("load-cell",), _factor_shift, _factor_error, 0.7),
    "delay-force": _Quantity(
        ("force", "load-cell"), _force_delay, _force_error, delayed=("force_N",)
    ),
    "delay-pose": _Quantity(("place",), _pose_delay, _place_error, delayed=("x_mm", "y_mm")),
}


def _rig(rng: np.random.Generator, on: Sequence[str]) -> list[AlienError]:
    """A rig with an open kind of error of a quantity, and none to two others of others."""
    kinds = [kind for kind in OPEN if FORMS[kind].on in on]
    others = [kind for kind in OPEN if FORMS[kind].on not in on]
    number = int(rng.integers(MAX_KINDS))
    drawn = [str(rng.choice(kinds)), *rng.choice(others, number, replace=False).tolist()]
    return alien_errors.draw(rng, drawn)


def _common(
    quantity: _Quantity, kind: str, seed: int, generator: str, rng: np.random.Generator
) -> Control:
    """A null whose reports are all off alike, beside the rig's own errors; its owner knows the
    contrast of touches, without which a factor of the force means nothing."""
    case = cases.draw(kind, seed, names=[], generator=generator, levels=ALIEN_LEVELS)
    errors = _rig(rng, quantity.on)
    own = quantity.error(case.true_states, alien_errors.reported(case.true_states, errors))
    if quantity.delayed:
        amount = log_uniform(rng, *DELAYS_S)
    else:
        amount = own * log_uniform(rng, *COMMON)
        while amount > quantity.largest:
            amount = own * log_uniform(rng, *COMMON)
    shift = quantity.shift(rng, case, amount)
    if quantity.delayed:
        own /= _rate(shift.true, quantity.delayed)
    clean = case.world.readings(shift.true, shift.laws)
    snr = signature(clean, case.world.readings(shift.reported, []), case.noise_V)
    believed = replace(case.believed, contrast_per_N=case.true.contrast_per_N)
    recorded = Recording(
        alien_errors.reported(shift.reported, errors),
        alien_errors.read(clean, errors, shift.reported, case.noise_V, rng),
        None,
        None,
        {**case.metadata, "skin": believed.metadata()},
    )
    presses = int(shift.reported["contact"].dropna().nunique())
    control = _control(replace(case, rig=tuple(errors)), recorded)
    return replace(
        control,
        effects=shift.laws,
        scopes=["common"] * len(shift.laws),
        snr=[snr] * len(shift.laws),
        common=Common(shift.name, shift.parameters, own, presses, snr),
    )


KINDS: dict[str, Callable[[str, int, str, np.random.Generator], Control]] = {
    **{f"white-{percent}": partial(_white, percent) for percent in WHITE_PERCENT},
    "single-frame": partial(_few_frames, False),
    "averaged-frames": partial(_few_frames, True),
    "unlabelled-white": partial(_unlabelled, ""),
    "unlabelled-alien": partial(_unlabelled, "alien"),
    **{name: partial(_common, quantity) for name, quantity in QUANTITIES.items()},
    "strong-pair": _strong_pair,
}
