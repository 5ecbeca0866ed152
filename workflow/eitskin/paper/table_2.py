"""Table II: how alike untouched frames are, simulated and recorded, and who notices what.

A simulation is made for each recording: on the recording's own channels and electrodes, all else as
the configuration's skin. Its frames are in the recording's unit; where that is not volt, one factor
brings the ideal skin's median reading to the recording's.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.atomic import atomic_path
from eitskin.data import recording
from eitskin.data.dataset import LOST_SHARE
from eitskin.errors import InputError
from eitskin.paper.similarity import MEASURES, Pool
from eitskin.physics.skin import Skin
from eitskin.quantities import listed
from eitskin.simulate import untouched_frames

LEAST_FRAMES = 20  # untouched ones, to z-score by
MOST_FRAMES = 240  # of a recording, evenly taken
LEVEL = 0.95
PLAIN, ALL, QUIET = "plain", "all", "noise-free"
NAMES = {"mmd": "MMD", "coral": "CORAL", "ncc": "NCC", "swd": "SWD"}
GROUP = ["recording", "origin", "configuration", "scale", "frames_recorded", "channels"]


@dataclass(frozen=True)
class Recorded:
    """Untouched frames (N, M) of a recording, whole, of the channels that were read and vary:
    `kept` (M,) of its table."""

    frames: np.ndarray
    kept: np.ndarray


def recorded(source: recording.Recording, name: str) -> Recorded:
    """At most MOST_FRAMES untouched frames of a recording, evenly taken.

    A channel lost in more than a tenth of them, or that never varies, is left out; then a frame
    with a reading lost. Raises InputError where a comparison has nothing to stand on.
    """
    if source.voltage is None or source.metadata["values"] != "absolute":
        found = "a query" if source.voltage is None else "differences"
        raise InputError(name, "voltage_V", found, "absolute readings")
    if source.metadata["skin"]["electrode_deg"] is None:
        raise InputError(name, "skin.electrode_deg", "null", "angles, to simulate with")
    voltage = source.voltage[~source.frames["touch"].to_numpy(bool)]
    kept = np.isnan(voltage).mean(axis=0) <= LOST_SHARE
    if not kept.any():
        raise InputError(name, "untouched frames", "every channel lost", "at least one channel")
    whole = voltage[np.isfinite(voltage[:, kept]).all(axis=1)]
    if len(whole) < LEAST_FRAMES:
        found = f"{len(whole)} whole ones"
        raise InputError(name, "untouched frames", found, f"{LEAST_FRAMES} or more, to z-score by")
    taken = np.linspace(0, len(whole) - 1, min(len(whole), MOST_FRAMES)).round().astype(int)
    kept &= np.ptp(whole[taken], axis=0) > 0
    if not kept.any():
        raise InputError(name, "untouched frames", "no channel that varies", "noise, at least")
    return Recorded(whole[np.ix_(taken, kept)], np.flatnonzero(kept))


def compare(
    source: recording.Recording,
    name: str,
    skin: dict,
    configuration: str,
    block: dict,
    force_N: np.ndarray,
    accuracy: str,
    seed: int,
    sessions: int,
    frames: int,
    permutations: int,
) -> pd.DataFrame:
    """Rows of Table II of one recording and one configuration, `block`: four measures of the plain
    simulation, the whole perturbed one, each effect alone and the plain one without noise.

    `low`, `high`: the recording's own random halves; `change`: against plain, with the permutation
    band; `notices`: whether it lies outside. Raises InputError as `recorded` and
    `readings.simulate` do.
    """
    own = recorded(source, name)
    sets = _simulated(source, own, skin, block, sessions, frames, force_N, accuracy, seed)
    scale = 1.0
    if source.metadata["unit"] != "V":
        scale = float(np.median(np.abs(own.frames)) / np.median(np.abs(sets[QUIET])))
    size = sessions * frames
    pool = Pool(
        np.concatenate([own.frames, *(scale * voltage for voltage in sets.values())]),
        np.arange(len(own.frames)),
        seed,
    )
    rows = {
        label: len(own.frames) + k * size + np.arange(size).reshape(sessions, frames)
        for k, label in enumerate(sets)
    }
    found = _measured(pool, rows, permutations, seed)
    source_name = source.metadata["source"]
    origin = "simulated" if source_name == "simulation" else source_name
    for column, value in enumerate((name, origin, configuration)):
        found.insert(column, GROUP[column], value)
    return found.assign(
        frames_recorded=len(own.frames),
        frames_simulated=size,
        channels=len(own.kept),
        scale=scale,
    )


def _simulated(
    source: recording.Recording,
    own: Recorded,
    skin: dict,
    block: dict,
    sessions: int,
    frames: int,
    force_N: np.ndarray,
    accuracy: str,
    seed: int,
) -> dict[str, np.ndarray]:
    """Frames (sessions * frames, K) V of each simulation, on the recording's electrodes and in the
    channels that are kept of it, magnitudes where it has them."""
    effects, noise = block["effects"], block["noise"]
    believed = Skin.from_metadata(skin, "config.yaml")
    believed = replace(believed, electrode_deg=source.skin.electrode_deg)
    plan = untouched_frames.Plan(sessions, frames, force_N, accuracy, seed)
    magnitude = source.metadata["voltage"] == "magnitude"

    def simulated(kept: list[dict], noise: float) -> np.ndarray:
        voltage = untouched_frames.frames(believed, source.channels, effects, kept, noise, plan)
        return (np.abs(voltage) if magnitude else voltage)[:, own.kept]

    sets = {PLAIN: simulated([], noise), ALL: simulated(effects, noise)}
    sets |= {label: simulated([item], noise) for label, item in _labels(effects).items()}
    sets[QUIET] = simulated([], 0.0)
    return sets


def _measured(
    pool: Pool, rows: dict[str, np.ndarray], permutations: int, seed: int
) -> pd.DataFrame:
    """What every measure says of each simulation, its rows (sessions, frames) of the pool; with
    the recording's own halves, and of the change against plain the band of its permutations."""
    tails = (0.5 - LEVEL / 2, 0.5 + LEVEL / 2)
    rng = np.random.default_rng([seed, 5])
    low, high = np.quantile(pool.halves(permutations, rng), tails, axis=0)
    plain = pool.compare(rows[PLAIN].ravel(), pool.real)
    found = []
    for label, at in rows.items():
        change, below, above = np.full((3, len(MEASURES)), np.nan)
        value = plain
        if label != PLAIN:
            change, permuted = pool.changes(at, rows[PLAIN], permutations, rng)
            below, above = np.quantile(permuted, tails, axis=0)
            value = pool.compare(at.ravel(), pool.real)
        for k, (measure, nearer) in enumerate(MEASURES.items()):
            outside = bool(change[k] < below[k] or change[k] > above[k])
            closer = (change[k] < 0) == (nearer == "lower")
            terms = pool.mmd_terms(at.ravel()) if measure == "mmd" else (np.nan,) * 3
            found.append(
                {
                    "simulation": label,
                    "measure": measure,
                    "value": value[k],
                    "halves_low": low[k],
                    "halves_high": high[k],
                    "change": change[k],
                    "band_low": below[k],
                    "band_high": above[k],
                    "notices": "" if label == PLAIN else "yes" if outside else "no",
                    "direction": ("nearer" if closer else "farther") if outside else "",
                    "mmd_within_simulation": terms[0],
                    "mmd_within_recording": terms[1],
                    "mmd_across": terms[2],
                }
            )
    return pd.DataFrame(found)


def _labels(effects: list[dict]) -> dict[str, dict]:
    """Effects by name, numbered where a name stands twice."""
    names = [item["name"] for item in effects]
    return {
        name if names.count(name) == 1 else f"{name} {names[: k + 1].count(name)}": item
        for k, (name, item) in enumerate(zip(names, effects, strict=True))
    }


def write(
    recordings: dict[str, str | Path],
    mesh: str | Path,
    published: str | Path,
    csv: str | Path,
    markdown: str | Path,
    skin: dict,
    configurations: dict[str, dict],
    accuracy: str,
    seed: int,
    sessions: int,
    frames: int,
    permutations: int,
) -> list[str]:
    """Write Table II of every recording (file by name) and configuration to `csv` and `markdown`,
    the paper's numbers, of the file `published`, beside; returns a line for every recording that
    is left out, with the reason.

    Raises InputError where none can be compared.
    """
    with np.load(mesh) as laid:
        force_N = laid["force_N"]
    tables, left_out = [], []
    for name, path in recordings.items():
        source = recording.read(path)
        try:
            tables += [
                compare(
                    source,
                    name,
                    skin,
                    configuration,
                    block,
                    force_N,
                    accuracy,
                    seed,
                    sessions,
                    frames,
                    permutations,
                )
                for configuration, block in configurations.items()
            ]
        except InputError as error:
            left_out.append(f"{name} is left out of Table II: {error}")
    if not tables:
        raise InputError("table_2", "recordings", json.dumps(left_out), "one that can be compared")
    rows = pd.concat(tables, ignore_index=True)
    paper = pd.read_csv(published).rename(columns={"value": "paper"})
    rows = rows.merge(paper, on=["simulation", "measure"], how="left", validate="many_to_one")
    with atomic_path(csv) as temporary:
        rows.to_csv(temporary, index=False, float_format="%.6g")
    with atomic_path(markdown) as temporary:
        temporary.write_text(to_markdown(rows, left_out, permutations), encoding="utf-8")
    return left_out


def to_markdown(rows: pd.DataFrame, left_out: list[str], permutations: int) -> str:
    """A section for each recording and configuration: the table, then its reading in words."""
    lines = [
        "# Table II",
        "",
        "Untouched frames, simulated against recorded. MMD, CORAL and SWD on channels z-scored by",
        "the recording, NCC on the means of the readings as they are (z-scored by the recording",
        "its own mean is 0 on every channel). Nearer is lower but for NCC.",
        "",
        "`plain` has noise alone; `all` every effect; then each effect alone, with the draws it",
        "has in `all`; `noise-free` is plain without its noise. A star: the measure notices it,",
        f"the change against `plain` lies outside the 95 % band of {permutations} permutations in",
        "which sessions changed sides at random. One star in twenty is chance. In brackets of",
        "their own the paper's numbers, against its own recording, which was never published; how",
        "it scaled MMD and CORAL is not known.",
    ]
    for line in left_out:
        lines += ["", f"**{line}**"]
    for (name, origin, configuration, scale, count, channels), group in rows.groupby(
        GROUP, sort=False
    ):
        lines += ["", f"## {name} ({origin}) · {configuration}", ""]
        lines += [f"{count} recorded frames of {channels} channels."]
        if scale != 1.0:
            lines += [f"Its unit is not volt: simulated readings are multiplied by {scale:.4g}."]
        lines += ["", "| simulation | " + " | ".join(NAMES.values()) + " |", "|---" * 5 + "|"]
        for label, cells in group.groupby("simulation", sort=False):
            columns = ("measure", "value", "notices", "paper")
            text = " | ".join(_cell(*cell) for cell in cells[[*columns]].itertuples(index=False))
            lines.append(f"| {label} | {text} |")
        own = group[group["simulation"] == PLAIN]
        halves = " | ".join(f"{c.halves_low:.4g} … {c.halves_high:.4g}" for c in own.itertuples())
        lines += [f"| the recording's own halves, 95 % | {halves} |", "", *reading(group)]
    return "\n".join(lines) + "\n"


def _cell(measure: str, value: float, notices: str, paper: float) -> str:
    text = f"{value:.4f}" if measure == "ncc" else f"{value:.3f}"
    text += "*" if notices == "yes" else ""
    return text + (f" ({paper:g})" if pd.notna(paper) else "")


def reading(group: pd.DataFrame) -> list[str]:
    """Sentences on one recording and configuration: which measure notices which perturbation, and
    whether all of them together bring the simulation nearer."""
    lines = []
    plain = group[group["simulation"] == PLAIN]
    outside = [
        NAMES[c.measure] for c in plain.itertuples() if not c.halves_low <= c.value <= c.halves_high
    ]
    told = f"{_named(outside)} tell" if len(outside) > 1 else f"{_named(outside)} tells"
    lines.append(f"- {told} the plain simulation from another half of the recording.")
    alone = group[~group["simulation"].isin([PLAIN, ALL])]
    for measure, cells in alone.groupby("measure", sort=False):
        seen = [f"{c.simulation} ({c.direction})" for c in cells.itertuples() if c.notices == "yes"]
        missed = [c.simulation for c in cells.itertuples() if c.notices == "no"]
        rest = f"; not {_named(missed)}" if missed else ", every one"
        lines.append(f"- {NAMES[measure]} notices {_named(seen)}{rest}.")
    whole = group[group["simulation"] == ALL]
    by = {
        word: _named([NAMES[c.measure] for c in whole.itertuples() if c.direction == direction])
        for word, direction in (("nearer", "nearer"), ("farther", "farther"), ("the same", ""))
    }
    told = "; ".join(f"{word} by {names}" for word, names in by.items())
    lines.append(f"- All effects together, against plain: {told}.")
    before, after = (group[group["simulation"] == s].iloc[0] for s in (PLAIN, ALL))
    own = after["mmd_within_simulation"] - before["mmd_within_simulation"]
    recording_s = after["mmd_within_recording"] - before["mmd_within_recording"]
    across = -2.0 * (after["mmd_across"] - before["mmd_across"])
    lines.append(
        f"- Of MMD's change from plain to all, {after['change']:+.2f}, the simulated frames' "
        f"likeness to one another makes {own:+.2f}, that of the recorded ones {recording_s:+.2f}, "
        f"and the likeness between the two sets {across:+.2f}: only the last is nearness."
    )
    return lines


def _named(names: list[str]) -> str:
    return listed(names) or "none"
