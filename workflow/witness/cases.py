"""Recordings with known truth.

    draw("single:contact-impedance", 7), draw("null", 1), draw("pair", 3), draw("outside:palm", 2),
    draw("null", 1, generator="elements"), draw("pair+rig", 3), draw("null+rig:spikes", 1),
    draw("pair+alien", 3), draw("null+alien:gain-steps", 1), draw("null+sealed", 1)
    draw("null+outline", 1, generator="elements"), draw("null+outline+rig", 1, generator="elements")

Sixteen electrodes, adjacent drives and pairs; `draw` lists the random quantities. Equal kinds and
seeds give the same case bit for bit.
"""

import json
import zlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.errors import InputError
from eitskin.physics.outline import as_stated
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from witness import alien_errors, outside, rig_errors, strengths
from witness.alien_errors import AlienError
from witness.generators import GENERATORS, LAWS, Generator
from witness.outline_cases import CONCEALING, SMOOTH, sized_outline, spread
from witness.outlines import Outline
from witness.rig_errors import USUAL, RigError
from witness.schedule import REACH, Keep, query_frames, recording_frames
from witness.world import World

N_ELECTRODES = 16
LEAST_LEVEL, MOST_LEVEL = 3e-4, 2e-2  # noise over the median |v|: from a good rig to a poor one
ALIEN_LEVELS = (1e-4, 1e-2)  # likewise, of nulls by rigs with errors in other forms
# Kinds of errors that may be named, by the word after + in the kind of a case.
RIG_KINDS: dict[str, Collection[str]] = {
    "rig": USUAL,
    "alien": alien_errors.OPEN,
    "sealed": alien_errors.SEALED,
}
# Detectable, but not trivially; more in sets and outside the catalogue, where signatures overlap.
SINGLE_SNR, SET_SNR, OUTSIDE_SNR = (10.0, 60.0), (15.0, 80.0), (20.0, 100.0)
CLEAR_MM = 8.0  # radius of the untouched disc of laws that act in one
UNREACHABLE_SNR = 1e12  # above that of any strength
OFF_RIM_MM = 4.0  # of touches and patches on outlines
OUTLINE_FRAMES = 60  # of a recording there, where every place has a mesh of its own
APART_MM, NO_TANGENT_MM = 1.5, 0.5  # from an edge to that of any touch; where they may cross
# Two of a group cannot be solved by the witness, not in reasonable time, or are one effect.
INCOMPATIBLE = (
    *(
        ("third-dimension", name)
        for name in (
            "domain-shape",
            "anisotropy",
            "conductivity-gradient",
            "conductivity-patch",
            "indenter-grounding",
            "conductivity-drift",
            "contact-drift",
            "force-dependent-impedance",
        )
    ),
    ("anisotropy", "conductivity-gradient", "indenter-grounding"),
    ("electrode-open", "electrode-swap"),
)
# A law by its strength, a unit of strength, the largest strength; unit None: the largest alone.
Maker = tuple[Callable[[float], dict | outside.Outside], float | None, float]
DISCS_ALONE = ("third-dimension", "conductivity-gradient")  # laws that outlines do not have
ON_OUTLINES = tuple(name for name in strengths.DRAWN if name not in DISCS_ALONE)
OUTLINE = "outline"  # the word after + in the kind of a case
NEEDS = {"contact-impedance": "contact_impedivity_ohm_m2", "touch-contrast": "contrast_per_N"}


@dataclass(frozen=True)
class Blinding:
    """Blinding of a case: frames and metadata are independent of the kind, except for `deep`.

    Every source is sink-grounded and every owner knows the contrast, as some effects would
    otherwise be unidentifiable; a third do not know the contacts, for any kind; all touches keep
    clear of a disc in which a law may act. query_frames: of every query; deep: the nominal skin is
    a body with low electrodes, without which the third dimension has no effect; levels: the range
    of the noise over the median |v|.
    """

    query_frames: int
    deep: bool = False
    levels: tuple[float, float] = (LEAST_LEVEL, MOST_LEVEL)


@dataclass(frozen=True)
class Case:
    """One recording with its truth.

    believed, true: the nominal and the true skin; effects: in the configuration's form, with their
    scopes and snr (of the signature without an overall factor; `snr`: of the effect alone,
    `snr_given_others`: in its set); outside: {law, parameters, snr} or None; states, query: frames
    in the recording format; clean, voltage (N, M), query_clean (Q, M) V; noise_V (M,): sd; level:
    over the median |v|; world: the solver of `clean` with its cache; rig: errors, by which `states`
    differ from the `true_states` of `clean`, and `voltage` from `clean`: of `rig_errors`, or all of
    `alien_errors`.
    """

    kind: str
    seed: int
    believed: Skin
    true: Skin
    effects: list[dict]
    scopes: list[str]
    snr: list[float]
    snr_given_others: list[float]
    outside: dict | None
    metadata: dict
    states: pd.DataFrame
    clean: np.ndarray
    voltage: np.ndarray
    noise_V: np.ndarray
    level: float
    query: pd.DataFrame
    query_clean: np.ndarray
    world: World
    rig: tuple[RigError, ...]
    true_states: pd.DataFrame

    @property
    def recorded(self) -> recording.Recording:
        """The recording, as its owner has it."""
        return recording.Recording(self.states, self.voltage, None, None, dict(self.metadata))


def owners_metadata(channels: np.ndarray, frame_s: float, believed: Skin) -> dict:
    """The metadata of a simulated recording with its nominal skin; channels (M, 4)."""
    return recording.metadata_of(channels, believed.metadata(), "simulation", frame_s=frame_s)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A log-uniform number in a range, with three significant digits."""
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")


class _Shown:
    """The readings of a world at some states, cached by their laws."""

    def __init__(self, world: World, states: pd.DataFrame):
        self.world, self.states = world, states
        self._readings: dict = {}

    def readings(self, laws: list[dict], hidden: outside.Outside | None = None) -> np.ndarray:
        """(N, M) V, noise-free."""
        key = repr((laws, hidden))
        if key not in self._readings:
            self._readings[key] = self.world.readings(self.states, laws, hidden)
        return self._readings[key]

    def snr(self, law: dict | outside.Outside, noise_V: np.ndarray) -> float:
        """The SNR of one law, of the catalogue or outside it, in noise (M,) V."""
        laws, hidden = ([law], None) if isinstance(law, dict) else ([], law)
        return signature(self.readings(laws, hidden), self.readings([]), noise_V)


@dataclass(frozen=True)
class _Bench:
    """A skin and its frames before anything is concealed. skin: with its true values except for the
    conductivity; free: a disc (x, y, radius), mm, in which a law may act; grounded: whether the
    source's sink is; outline: of a skin that is no disc; the other fields as in `Case`."""

    skin: Skin
    true: Skin
    believed: Skin
    frame_s: float
    grounded: bool
    free: tuple[float, float, float]
    channels: np.ndarray
    states: pd.DataFrame
    query: pd.DataFrame
    outline: Outline | None = None

    def world(self, generator: str) -> World:
        """The world of the true skin."""
        return World(
            self.true,
            self.channels,
            self.frame_s,
            self.grounded,
            generator=generator,
            outline=self.outline,
        )

    def scene(self, untouched_V: np.ndarray) -> strengths.Scene:
        """The scene of effects, with readings (M,) V of the untouched skin."""
        thickness = self.skin.thickness_mm
        assert thickness is not None
        return strengths.Scene(
            self.believed, self.channels, untouched_V, self.free, self.grounded, thickness
        )


def together(names: Sequence[str]) -> bool:
    """Whether the witness can combine effects in one recording."""
    return all(len(set(group) & set(names)) < 2 for group in INCOMPATIBLE)


def names_of(
    kind: str, rng: np.random.Generator, generator: str = "boundary"
) -> tuple[list[str], str | None]:
    """The effects of a kind, in sets drawn among those that the generator can solve, and the law
    outside the catalogue.

    Raises InputError for an unknown kind, or one that the generator cannot solve.
    """
    word, _, name = kind.partition(":")
    solver = _generator(generator)
    if word in ("single", "outside") and name in solver.unable:
        able_generators = ", ".join(
            g for g, solver_of_name in GENERATORS.items() if solver_of_name.does(name)
        )
        raise InputError("case", f"generator of {kind}", repr(generator), able_generators)
    if kind == "null":
        return [], None
    if word == "single" and name in strengths.DRAWN:
        return [name], None
    if word == "outside" and name in LAWS:
        return [], name
    if kind in ("pair", "triple"):
        while True:
            size = 2 if kind == "pair" else 3
            able_names = [drawn for drawn in sorted(strengths.DRAWN) if solver.does(drawn)]
            names = rng.choice(able_names, size, replace=False).tolist()
            if together(names):
                return names, None
    expected = "null, single:<name>, pair, triple or outside:<law>"
    raise InputError("case", "kind", repr(kind), expected)


def _generator(name: str) -> Generator:
    if name not in GENERATORS:
        raise InputError("case", "generator", repr(name), ", ".join(sorted(GENERATORS)))
    return GENERATORS[name]


def _draw_skin(rng: np.random.Generator) -> Skin:
    def between(low: float, high: float, digits: int) -> float:
        return round(float(rng.uniform(low, high)), digits)

    return Skin(
        radius_mm=between(50.0, 90.0, 1),
        thickness_mm=between(2.0, 4.0, 2),
        conductivity_S_per_m=between(0.2, 1.0, 3),
        electrode_deg=tuple((360.0 / N_ELECTRODES * np.arange(N_ELECTRODES)).tolist()),
        electrode_width_mm=between(4.0, 9.0, 1),
        contact_impedivity_ohm_m2=log_uniform(rng, 5e-4, 1e-2),
        current_A=log_uniform(rng, 1e-4, 5e-3),
        contrast_per_N=between(0.2, 1.0, 3),
    )


def _outline_name(kind: str, seed: int, names: list[str], law: str | None) -> str:
    """The outline of a case; in turn those that the witness can solve with its effects."""
    if law is not None or not set(names) <= set(ON_OUTLINES):
        raise InputError("case", f"{OUTLINE} of {kind}", kind, ", ".join(ON_OUTLINES))
    choice = SMOOTH if "domain-shape" in names else CONCEALING
    return choice[(zlib.crc32(kind.encode()) + seed) % len(choice)]


def _laid_out(skin: Skin, outline_name: str) -> tuple[Skin, Outline]:
    """A disc's skin on an outline of its area, electrodes far from corners; radius and angles are
    the outline's length over 2 pi and shares of it."""
    assert skin.radius_mm is not None and skin.electrode_width_mm is not None
    outline, stated = sized_outline(outline_name, skin.radius_mm)
    share = spread(outline, N_ELECTRODES, skin.electrode_width_mm)
    deg = tuple((360.0 * share).tolist())
    return replace(skin, radius_mm=outline.unit_mm, electrode_deg=deg, outline=stated), outline


def _deepened(rng: np.random.Generator, skin: Skin) -> Skin:
    """A skin 10 to 25 mm thick, its electrodes 3 to 8 mm high."""
    depth = round(float(rng.uniform(10.0, 25.0)), 1)
    height = round(float(rng.uniform(3.0, 8.0)), 1)
    z = round(float(rng.uniform(0.5 * height, depth - 0.5 * height)), 2)
    return replace(
        skin, thickness_mm=depth, electrode_height_mm=height, electrode_z_mm=max(z, 0.5 * height)
    )


def _incomplete(rng: np.random.Generator, skin: Skin, names: list[str], blinded: bool) -> Skin:
    """The nominal skin: in a third of the cases without contacts, contrast or both; blinded: always
    without contacts, for any names."""
    unknown = rng.uniform() < 1 / 3
    choice = int(rng.integers(3))
    if not unknown:
        return skin
    if blinded:
        return replace(skin, contact_impedivity_ohm_m2=None)
    keys: tuple[str, ...] = ("contact_impedivity_ohm_m2", "contrast_per_N")
    keys = keys if choice == 2 else keys[choice : choice + 1]
    needed_keys = {NEEDS[name] for name in names if name in NEEDS}
    return replace(skin, **{key: None for key in keys if key not in needed_keys})


def _drawn(name: str, rng: np.random.Generator, scene: strengths.Scene) -> strengths.Strength:
    """A random effect; no common contact impedance where the nominal skin has none."""
    while True:
        strength = strengths.DRAWN[name](rng, scene)
        is_known = scene.skin.contact_impedivity_ohm_m2 is not None
        if is_known or name != "contact-impedance" or strength.scope != "common":
            return strength


def _free_disc(rng: np.random.Generator, radius_mm: float, low: float, high: float) -> tuple:
    r = radius_mm * np.sqrt(rng.uniform(0.0, 0.5))
    phi = rng.uniform(0.0, 2.0 * np.pi)
    place = r * np.exp(1j * phi)
    values = (place.real, place.imag, rng.uniform(low, high))
    return tuple(round(float(value), 2) for value in values)


def signature(changed: np.ndarray, plain: np.ndarray, noise_V: np.ndarray) -> float:
    """The SNR of changed - plain (N, M) V in noise (M,) V, orthogonal to an overall factor."""
    change = ((changed - plain) / noise_V).ravel()
    factor = (plain / noise_V).ravel()
    residual = change - factor * (factor @ change) / (factor @ factor)
    return float(np.linalg.norm(residual))


def scaled(
    snr_at: Callable[[float], float], unit: float, max_strength: float, target_snr: float
) -> tuple[float, float]:
    """The strength at which snr_at(strength) is `target_snr` to 5 %, or the largest possible one,
    and its SNR. snr_at raises ValueError for a strength without a physical state.
    """
    strength, best = min(unit, max_strength), (0.0, 0.0)
    for _ in range(12):
        strength = float(f"{strength:.4g}")
        try:
            snr = snr_at(strength)
        except ValueError:
            max_strength = 0.9 * strength
            strength = (
                0.5 * (best[0] + max_strength) if best[0] < max_strength else 0.5 * max_strength
            )
            continue
        if abs(np.log(max(snr, 1e-9) / target_snr)) < abs(np.log(max(best[1], 1e-9) / target_snr)):
            best = strength, snr
        if abs(snr / target_snr - 1.0) < 0.05:
            break
        step = float(np.clip(target_snr / max(snr, 1e-9), 0.1, 10.0))
        if step > 1.0 and strength >= 0.999 * max_strength:
            break
        strength = min(strength * step, max_strength)
    return best


def draw(
    kind: str,
    seed: int,
    frames: int | None = None,
    generator: str = "boundary",
    names: list[str] | None = None,
    blinding: Blinding | None = None,
    share: float | None = None,
    levels: tuple[float, float] | None = None,
    snr: tuple[float, float] | None = None,
) -> Case:
    """One case. kind: null, single:<name>, pair, triple or outside:<law>; or any word, where the
    `names` of its effects are given; with +rig, the same case recorded by a rig with errors, or
    with +rig:<kind>,<kind> with these; +alien and +sealed: likewise with errors of `alien_errors`,
    a null's noise then being 0.01 % to 1 %; with +outline, before these, OUTLINE_FRAMES of a skin
    of one of `outline_cases.CONCEALING`, in turn, by the generator elements. generator: the solver
    of the stored readings, of `generators.GENERATORS`; strengths are determined with the boundary
    where it can solve the law.

    Skin: radius 50 to 90 mm, thickness 2 to 4 mm (10 to 25 as a body), contacts 4 to 9 mm wide
    of 5e-4 to 1e-2 ohm m2, conductivity up to 15 % off; 100 to 150 frames, or `frames`; noise
    0.03 % to 2 % of the median |v|. SNR 10 to 60 for single effects, 15 to 80 in sets, 20 to 100
    outside the catalogue; where no physical strength reaches it, the noise is reduced, to no less
    than 0.03 % or the generator's least. share: of the largest physical strengths, in place of an
    SNR; levels, snr: other ranges of the noise over the median |v| and of the SNR. Raises
    InputError for an unknown kind, one that the generator cannot solve or an outline does not have,
    or a `share` of a strength that is drawn.
    """
    full_kind, (kind, _, rig) = kind, kind.partition("+")
    rng = np.random.default_rng([zlib.crc32(kind.encode()), seed])
    names, law = names_of(kind, rng, generator) if names is None else (names, None)
    outline_name = None
    if rig.partition("+")[0] == OUTLINE:
        outline_name, rig = _outline_name(kind, seed, names, law), rig.partition("+")[2]
    word = rig.partition(":")[0]
    if levels is None:
        levels = (LEAST_LEVEL, MOST_LEVEL) if blinding is None else blinding.levels
        if word in ("alien", "sealed") and blinding is None and not names and law is None:
            levels = ALIEN_LEVELS
    band = snr or (OUTSIDE_SNR if law else SINGLE_SNR if len(names) < 2 else SET_SNR)
    if outline_name is not None:
        frames = frames or OUTLINE_FRAMES
    bench = _bench(rng, names, law, frames, blinding, outline_name)
    is_boundary_able = law not in outside.OUTSIDE_SOLID and outline_name is None
    searched = "boundary" if is_boundary_able else generator
    shown = _Shown(bench.world(searched), bench.states)
    floor = max(levels[0], GENERATORS[generator].least_level)
    concealed = _concealed(rng, bench, shown, _Goal(names, law, share, band), levels, floor)
    clean = _noiseless(bench, shown, concealed, generator)
    stream = f"{kind}+{word or 'rig'}".encode()
    errors = _rig_errors(rig, np.random.default_rng([zlib.crc32(stream), seed]))
    return _recorded(replace(clean, kind=full_kind, seed=seed), errors, rng)


def _bench(
    rng: np.random.Generator,
    names: list[str],
    law: str | None,
    frames: int | None,
    blinding: Blinding | None,
    outline_name: str | None = None,
) -> _Bench:
    """A skin and its frames, suited to the effects and the law outside the catalogue."""
    skin, outline = _draw_skin(rng), None
    if outline_name is not None:
        skin, outline = _laid_out(skin, outline_name)
    deep = "third-dimension" in names or (blinding is not None and blinding.deep)
    if deep:
        skin = _deepened(rng, skin)
    believed = _incomplete(rng, skin, names, blinding is not None)
    if deep and rng.uniform() < 0.5:
        believed = replace(believed, thickness_mm=None)
    assert skin.radius_mm is not None and skin.conductivity_S_per_m is not None
    conductivity_ratio = 1.0 + rng.uniform(-0.15, 0.15)
    true = replace(skin, conductivity_S_per_m=float(skin.conductivity_S_per_m * conductivity_ratio))
    frame_s = round(float(rng.uniform(0.2, 0.4)), 3)
    grounded = "indenter-grounding" in names or ("ground-leak" in names and rng.uniform() < 0.5)
    radius_mm = skin.radius_mm
    if outline is not None:
        radius_mm = float(np.abs(outline.samples).max()) / REACH
    free, keep = _kept_clear(rng, radius_mm, names, law, blinding, outline)
    states = recording_frames(rng, radius_mm, frame_s, keep, frames)
    number = None if blinding is None else blinding.query_frames
    query = query_frames(rng, states, radius_mm, frame_s, keep, number)
    channels = channel_table(N_ELECTRODES)
    grounded = grounded or blinding is not None
    return _Bench(skin, true, believed, frame_s, grounded, free, channels, states, query, outline)


def _kept_clear(
    rng: np.random.Generator,
    radius_mm: float,
    names: list[str],
    law: str | None,
    blinding: Blinding | None,
    outline: Outline | None = None,
) -> tuple[tuple[float, float, float], Keep]:
    """A disc (x, y, radius), mm, in which a law may act, and the places that touches avoid."""
    x, y, reach = _free_disc(rng, radius_mm, 6.0, 13.0)
    if outline is not None:
        while outline.depth(complex(x, y)) < reach + OFF_RIM_MM:
            x, y, reach = _free_disc(rng, radius_mm, 6.0, 13.0)
        keep = Keep(outline=outline, off_rim_mm=OFF_RIM_MM)
        if "conductivity-patch" in names:
            keep = replace(keep, discs=((x, y, reach),), apart_mm=NO_TANGENT_MM, crossed=True)
        return (x, y, reach), keep
    clear = law is not None and LAWS[law].keeps_clear
    free = (x, y, CLEAR_MM if clear else reach)
    if blinding is not None:
        return free, Keep(((x, y, max(reach, CLEAR_MM)),), APART_MM, clear=True)
    if clear:
        return free, Keep((free,), APART_MM)
    if "conductivity-patch" in names:
        crossed = "indenter-grounding" not in names
        return free, Keep((free,), NO_TANGENT_MM if crossed else APART_MM, crossed)
    return free, Keep()


@dataclass(frozen=True)
class _Goal:
    """What a case is to conceal: effects by `names`, or a `law` outside the catalogue; share: as in
    `draw`; band: the range of the SNR."""

    names: list[str]
    law: str | None
    share: float | None
    band: tuple[float, float]


@dataclass(frozen=True)
class _Concealed:
    """The concealed effects of a case, and its noise; hidden: a law outside the catalogue,
    `outside` its entry in the truth; noise_V (M,): sd; the other fields as in `Case`."""

    effects: list[dict]
    scopes: list[str]
    snr: list[float]
    hidden: outside.Outside | None
    outside: dict | None
    level: float
    noise_V: np.ndarray


def _concealed(
    rng: np.random.Generator,
    bench: _Bench,
    shown: _Shown,
    goal: _Goal,
    levels: tuple[float, float],
    floor: float,
) -> _Concealed:
    """The effects, or the law outside the catalogue, with their strengths; levels: the range of
    the noise; floor: its least after a reduction."""
    names, law, share = goal.names, goal.law, goal.share
    plain = shown.readings([])
    level = max(log_uniform(rng, *levels), floor)
    mixed = rng.uniform(0.2, 0.8) if rng.uniform() < 0.3 else 0.0
    scene = bench.scene(plain[0])
    strength_list = [_drawn(name, rng, scene) for name in names]
    # With a wire off or on another electrode, the noise is that of the readings with this effect.
    board_readings = shown.readings(
        [strength.law_at(0.0) for strength in strength_list if strength.unit is None]
    )
    median = float(np.median(np.abs(plain[0])))
    noise = level * ((1.0 - mixed) * median + mixed * np.abs(board_readings[0]))
    hidden = None if law is None else _outside(rng, law, bench, plain[0])
    makers = _makers(strength_list, law, hidden, share)
    low, high = np.log(goal.band)
    target_snr = np.exp(rng.uniform(low, high, len(makers)))
    if share is not None:
        target_snr[:] = UNREACHABLE_SNR
    amounts_and_snr = _strengths(shown, makers, target_snr, noise)
    shares = (snr / want for (_, snr), want in zip(amounts_and_snr, target_snr, strict=True))
    largest_shortfall = min(shares, default=1)
    if largest_shortfall < 0.9 and share is None:
        # The largest physical strength is too weak in this noise, so that the noise is reduced.
        quieter = max(largest_shortfall, floor / level)
        level, noise = level * quieter, noise * quieter
        amounts_and_snr = _strengths(shown, makers, target_snr, noise)
    amounts = iter(amounts_and_snr)
    effects, snr, outside_entry = [], [], None
    for strength in strength_list:
        fixed = strength.unit is None
        amount, snr_reached = (
            (0.0, shown.snr(strength.law_at(0.0), noise)) if fixed else next(amounts)
        )
        effects.append(strength.law_at(amount))
        snr.append(snr_reached)
    if hidden is not None:
        amount, snr_reached = next(amounts)
        hidden = replace(hidden, amount=amount)
        outside_entry = {"law": law, "parameters": hidden.parameters(), "snr": snr_reached}
    return _Concealed(
        effects,
        [strength.scope for strength in strength_list],
        snr,
        hidden,
        outside_entry,
        level,
        noise,
    )


def _makers(
    drawn: list[strengths.Strength],
    law: str | None,
    hidden: outside.Outside | None,
    share: float | None,
) -> list[Maker]:
    """The makers of all effects with a strength, or of the law outside the catalogue."""
    makers: list[Maker] = [
        (strength.law_at, strength.unit, strength.max_strength)
        for strength in drawn
        if strength.unit is not None and strength.max_strength is not None
    ]
    if hidden is not None:
        unit = None if law in outside.OUTSIDE_SOLID else 0.1 * hidden.max_amount
        makers = [(lambda a: replace(hidden, amount=a), unit, hidden.amount)]
    if share is None:
        return makers
    if law in outside.OUTSIDE_SOLID:
        raise InputError("case", "share", f"{share:g}", f"none with {law}: its strength is drawn")
    return [
        (law_at, min(unit, share * max_amount), share * max_amount)
        for law_at, unit, max_amount in makers
        if unit is not None
    ]


def _noiseless(bench: _Bench, shown: _Shown, concealed: _Concealed, generator: str) -> Case:
    """The case before its recording by a rig: noise-free, without kind and seed."""
    effects, world, states = concealed.effects, shown.world, bench.states
    clean = shown.readings(effects, concealed.hidden)
    snr_given_others = list(concealed.snr)
    if len(effects) > 1:
        reduced_sets = [[e for e in effects if e is not law] for law in effects]
        snr_given_others = [
            signature(clean, shown.readings(r), concealed.noise_V) for r in reduced_sets
        ]
    if generator != world.generator.name:
        world = bench.world(generator)
        clean = world.readings(states, effects, concealed.hidden)
    largest = float(states["force_N"].max())
    metadata = owners_metadata(bench.channels, bench.frame_s, as_stated(bench.believed))
    metadata["source_reference"] = "sink-grounded" if bench.grounded else "floating"
    return Case(
        kind="",
        seed=0,
        believed=bench.believed,
        true=bench.true,
        effects=effects,
        scopes=concealed.scopes,
        snr=concealed.snr,
        snr_given_others=snr_given_others,
        outside=concealed.outside,
        metadata=metadata,
        states=states,
        clean=clean,
        voltage=clean,
        noise_V=concealed.noise_V,
        level=concealed.level,
        query=bench.query,
        query_clean=world.readings(bench.query, effects, concealed.hidden, largest),
        world=world,
        rig=(),
        true_states=states,
    )


def again(case: Case, rig: str, number: int) -> Case:
    """The same skin and frames, recorded again at the same level of noise.

    rig: the part of a kind after +, or empty; its sizes and the noise are drawn for every `number`.
    Raises InputError for a case recorded by a rig with errors, or an unknown rig.
    """
    if case.rig:
        raise InputError("case", "kind", repr(case.kind), "one without +rig")
    kind = f"{case.kind}+{rig}" if rig else case.kind
    rng = np.random.default_rng([zlib.crc32(kind.encode()), case.seed, number])
    return _recorded(replace(case, kind=kind), _rig_errors(rig, rng), rng)


def _recorded(case: Case, errors: tuple[RigError, ...], rng: np.random.Generator) -> Case:
    """A case with its noise-free readings recorded by a rig with errors and random noise."""
    metadata, clean, query_clean = case.metadata, case.clean, case.query_clean
    forms = [error for error in errors if isinstance(error, AlienError)]
    if rig_errors.magnitudes(errors):
        metadata = {**metadata, "voltage": "magnitude"}
        clean, query_clean = np.abs(clean), np.abs(query_clean)
    return replace(
        case,
        metadata=metadata,
        states=alien_errors.reported(case.true_states, forms)
        if forms
        else rig_errors.reported(case.true_states, errors),
        clean=clean,
        voltage=alien_errors.read(clean, forms, case.true_states, case.noise_V, rng)
        if forms
        else rig_errors.read(clean, errors, case.true_states, case.noise_V, rng),
        query_clean=query_clean,
        rig=errors,
    )


def _rig_errors(rig: str, rng: np.random.Generator) -> tuple[RigError, ...]:
    """The errors after + in a kind: none, random ones, or those named; raises InputError."""
    if not rig:
        return ()
    word, _, kind_list = rig.partition(":")
    kinds = kind_list.split(",") if kind_list else None
    known_kinds = RIG_KINDS.get(word, ())
    if word not in RIG_KINDS or (kinds and not set(kinds) <= set(known_kinds)):
        words = "rig, alien, sealed, or one of them with : and some of its kinds"
        expected = f"{word}, or {word}: and some of {', '.join(known_kinds)}"
        raise InputError("case", "kind", repr(f"+{rig}"), expected if known_kinds else words)
    if word == "rig":
        return tuple(rig_errors.draw(rng, kinds))
    return tuple(alien_errors.draw(rng, kinds, sealed=word == "sealed"))


def _strengths(
    shown: _Shown, makers: list[Maker], target_snr: np.ndarray, noise_V: np.ndarray
) -> list[tuple[float, float]]:
    """Strength and SNR of each maker by `scaled`; without a unit those of the largest amount."""

    def show(law_at: Callable[[float], dict | outside.Outside], amount: float) -> float:
        return shown.snr(law_at(amount), noise_V)

    return [
        (max_amount, show(law_at, max_amount))
        if unit is None
        else scaled(partial(show, law_at), unit, max_amount, target)
        for (law_at, unit, max_amount), target in zip(makers, target_snr, strict=True)
    ]


def _outside(
    rng: np.random.Generator, law: str, bench: _Bench, untouched_V: np.ndarray
) -> outside.Outside:
    states = bench.states
    presses = states["contact"].dropna().unique().astype(int)
    end, radius = float(states["time_s"].iloc[-1]), bench.skin.radius_mm
    assert radius is not None
    scene = outside.Scene(N_ELECTRODES, presses, end, radius, bench.free, untouched_V)
    law_drawn = LAWS[law].draw(rng, scene)
    if isinstance(law_drawn, outside.Palm):
        law_drawn = replace(law_drawn, radius_mm=round(float(rng.uniform(4.0, 8.0)), 2))
    return law_drawn


def write(case: Case, folder: str | Path) -> None:
    """Write recording.parquet, query.parquet and truth.json into a folder.

    truth.json: {kind, seed, effects, scopes, snr, snr_given_others, outside, rig, true (the skin),
    noise_V (M), level, query_voltage_V (Q x M, noise-free)}.
    """
    folder = Path(folder)
    parts = {"recording": (case.states, case.voltage), "query": (case.query, None)}
    for name, (frames, voltage) in parts.items():
        recorded = recording.Recording(frames, voltage, None, None, case.metadata)
        recording.write(recorded, folder / f"{name}.parquet")
    truth = {
        "kind": case.kind,
        "seed": case.seed,
        "effects": case.effects,
        "scopes": case.scopes,
        "snr": case.snr,
        "snr_given_others": case.snr_given_others,
        "outside": case.outside,
        "rig": [{"kind": error.kind, "size": error.size} for error in case.rig],
        "true": case.true.metadata(),
        "noise_V": case.noise_V.tolist(),
        "level": case.level,
        "query_voltage_V": case.query_clean.tolist(),
    }
    with atomic_path(folder / "truth.json") as path:
        path.write_text(json.dumps(truth, indent=1), encoding="utf-8")
