"""Table II: the similarity of simulated and recorded untouched frames, by four measures, and the
effects that each measure notices.

Every recording has a simulation on its channels and electrodes, with all else of the
configuration's skin, in the recording's unit; where that is not volt, one factor maps the ideal
skin's median reading to the recording's.
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

MIN_FRAMES = 20  # untouched frames: standard deviations for z-scores to 16 %
MAX_FRAMES = 240  # of a recording, evenly spaced: distances of all pairs stay small
LEVEL = 0.95  # of the permutation bands
PLAIN, ALL, QUIET = "plain", "all", "noise-free"
NAMES = {"mmd": "MMD", "coral": "CORAL", "ncc": "NCC", "swd": "SWD"}
GROUP = ["recording", "origin", "configuration", "scale", "frames_recorded", "channels"]


@dataclass(frozen=True)
class UntouchedFrames:
    """Complete untouched frames (N, M) of a recording, and its `channels` (M,) that were read and
    vary."""

    frames: np.ndarray
    channels: np.ndarray


@dataclass(frozen=True)
class Design:
    """The simulated sets: the nominal `skin`, as `Skin.metadata`, the `plan` of their frames, and
    the number of `permutations` of a band."""

    skin: dict
    plan: untouched_frames.Plan
    permutations: int


def untouched_of(source: recording.Recording, name: str) -> UntouchedFrames:
    """At most MAX_FRAMES untouched frames of a recording, evenly spaced.

    Channels that are lost in more than a tenth of them or constant are left out, then frames with a
    lost reading. Raises InputError for differences, unknown angles and too few frames or channels.
    """
    if source.voltage is None or source.metadata["values"] != "absolute":
        content = "a query" if source.voltage is None else "differences"
        raise InputError(name, "voltage_V", content, "absolute readings")
    has_outline = source.skin.rim is not None
    if source.metadata["skin"]["electrode_deg"] is None and not has_outline:
        raise InputError(name, "skin.electrode_deg", "null", "angles, to simulate with")
    voltage = source.voltage[~source.frames["touch"].to_numpy(bool)]
    used_channels = np.isnan(voltage).mean(axis=0) <= LOST_SHARE
    if not used_channels.any():
        raise InputError(name, "untouched frames", "every channel lost", "at least one channel")
    complete_frames = voltage[np.isfinite(voltage[:, used_channels]).all(axis=1)]
    if len(complete_frames) < MIN_FRAMES:
        content = f"{len(complete_frames)} whole ones"
        raise InputError(name, "untouched frames", content, f"{MIN_FRAMES} or more, to z-score by")
    rows = (
        np.linspace(0, len(complete_frames) - 1, min(len(complete_frames), MAX_FRAMES))
        .round()
        .astype(int)
    )
    used_channels &= np.ptp(complete_frames[rows], axis=0) > 0
    if not used_channels.any():
        raise InputError(name, "untouched frames", "no channel that varies", "noise, at least")
    return UntouchedFrames(
        complete_frames[np.ix_(rows, used_channels)], np.flatnonzero(used_channels)
    )


def compare(
    source: recording.Recording,
    name: str,
    configuration: str,
    block: dict,
    design: Design,
) -> pd.DataFrame:
    """Rows of Table II of one recording and one configuration, `block`: four measures of the plain
    simulation, that with all effects, each effect alone and the plain one without noise.

    `halves_low`, `halves_high`: between random halves of the recording; `change`: against plain,
    with its permutation band; `notices`: whether it lies outside. Raises InputError as
    `untouched_of` and `readings.simulate` do.
    """
    untouched = untouched_of(source, name)
    sets = _simulated(source, untouched, block, design)
    scale = 1.0
    if source.metadata["unit"] != "V":
        scale = float(np.median(np.abs(untouched.frames)) / np.median(np.abs(sets[QUIET])))
    size = design.plan.sessions * design.plan.session_frames
    pool = Pool(
        np.concatenate([untouched.frames, *(scale * voltage for voltage in sets.values())]),
        np.arange(len(untouched.frames)),
        design.plan.seed,
    )
    rows = {
        label: len(untouched.frames)
        + k * size
        + np.arange(size).reshape(design.plan.sessions, design.plan.session_frames)
        for k, label in enumerate(sets)
    }
    table = _measured(pool, rows, design.permutations, design.plan.seed)
    source_name = source.metadata["source"]
    origin = "simulated" if source_name == "simulation" else source_name
    for column, value in enumerate((name, origin, configuration)):
        table.insert(column, GROUP[column], value)
    return table.assign(
        frames_recorded=len(untouched.frames),
        frames_simulated=size,
        channels=len(untouched.channels),
        scale=scale,
    )


def _simulated(
    source: recording.Recording,
    untouched: UntouchedFrames,
    block: dict,
    design: Design,
) -> dict[str, np.ndarray]:
    """Frames (sessions * frames, K) V of each simulation, on the recording's electrodes and in its
    used channels, magnitudes where the recording has them."""
    effects, noise = block["effects"], block["noise"]
    skin_of_recording = _on_electrodes(Skin.from_metadata(design.skin, "config.yaml"), source.skin)
    magnitude = source.metadata["voltage"] == "magnitude"

    def simulated(drawn_effects: list[dict], noise: float) -> np.ndarray:
        voltage = untouched_frames.frames(
            skin_of_recording, source.channels, effects, drawn_effects, noise, design.plan
        )
        return (np.abs(voltage) if magnitude else voltage)[:, untouched.channels]

    sets = {PLAIN: simulated([], noise), ALL: simulated(effects, noise)}
    sets |= {label: simulated([item], noise) for label, item in _labels(effects).items()}
    sets[QUIET] = simulated([], 0.0)
    return sets


def _on_electrodes(nominal: Skin, recorded: Skin) -> Skin:
    """The nominal skin with a recording's electrodes, and where it has one with its outline. Raises
    InputError for an outline beside a recording of a disc."""
    if recorded.rim is not None:
        return replace(
            nominal,
            radius_mm=None,
            outline=recorded.outline,
            electrode_deg=None,
            electrode_s=recorded.electrode_s,
            electrode_xy_mm=recorded.electrode_xy_mm,
        )
    if nominal.rim is not None:
        expected = "a disc, as the recordings that are compared with it"
        raise InputError("config.yaml", "skin.outline", "an outline", expected)
    return replace(nominal, electrode_deg=recorded.electrode_deg)


def _measured(
    pool: Pool, rows: dict[str, np.ndarray], permutations: int, seed: int
) -> pd.DataFrame:
    """Every measure of each simulation, given by its rows (sessions, frames) of the pool, with the
    interval of the recording's halves and the permutation band of the change against plain."""
    tails = (0.5 - LEVEL / 2, 0.5 + LEVEL / 2)
    rng = np.random.default_rng([seed, 5])
    low, high = np.quantile(pool.halves(permutations, rng), tails, axis=0)
    plain = pool.compare(rows[PLAIN].ravel(), pool.real)
    table_rows = []
    for label, simulation_rows in rows.items():
        change, band_low, band_high = np.full((3, len(MEASURES)), np.nan)
        value = plain
        if label != PLAIN:
            change, permuted_changes = pool.changes(simulation_rows, rows[PLAIN], permutations, rng)
            band_low, band_high = np.quantile(permuted_changes, tails, axis=0)
            value = pool.compare(simulation_rows.ravel(), pool.real)
        for k, (measure, nearer_direction) in enumerate(MEASURES.items()):
            is_noticed = bool(change[k] < band_low[k] or change[k] > band_high[k])
            is_nearer = (change[k] < 0) == (nearer_direction == "lower")
            terms = pool.mmd_terms(simulation_rows.ravel()) if measure == "mmd" else (np.nan,) * 3
            table_rows.append(
                {
                    "simulation": label,
                    "measure": measure,
                    "value": value[k],
                    "halves_low": low[k],
                    "halves_high": high[k],
                    "change": change[k],
                    "band_low": band_low[k],
                    "band_high": band_high[k],
                    "notices": "" if label == PLAIN else "yes" if is_noticed else "no",
                    "direction": ("nearer" if is_nearer else "farther") if is_noticed else "",
                    "mmd_within_simulation": terms[0],
                    "mmd_within_recording": terms[1],
                    "mmd_across": terms[2],
                }
            )
    return pd.DataFrame(table_rows)


def _labels(effects: list[dict]) -> dict[str, dict]:
    """Effects by name, numbered where a name is repeated."""
    names = [item["name"] for item in effects]
    return {
        name if names.count(name) == 1 else f"{name} {names[: k + 1].count(name)}": item
        for k, (name, item) in enumerate(zip(names, effects, strict=True))
    }


def write(
    recordings: dict[str, str | Path],
    configurations: dict[str, dict],
    design: Design,
    published: str | Path,
    csv: str | Path,
    markdown: str | Path,
) -> list[str]:
    """Write Table II of every recording (file by name) and configuration to `csv` and `markdown`,
    with the paper's numbers of the file `published`; returns a line with the reason for every
    recording that is left out.

    Raises InputError where none can be compared.
    """
    tables, left_out = [], []
    for name, path in recordings.items():
        source = recording.read(path)
        try:
            tables += [
                compare(source, name, configuration, block, design)
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
        temporary.write_text(to_markdown(rows, left_out, design.permutations), encoding="utf-8")
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
        plain_rows = group[group["simulation"] == PLAIN]
        halves = " | ".join(
            f"{c.halves_low:.4g} … {c.halves_high:.4g}" for c in plain_rows.itertuples()
        )
        lines += [f"| the recording's own halves, 95 % | {halves} |", "", *reading(group)]
    return "\n".join(lines) + "\n"


def _cell(measure: str, value: float, notices: str, paper: float) -> str:
    text = f"{value:.4f}" if measure == "ncc" else f"{value:.3f}"
    text += "*" if notices == "yes" else ""
    return text + (f" ({paper:g})" if pd.notna(paper) else "")


def reading(group: pd.DataFrame) -> list[str]:
    """Sentences on one recording and configuration: the effects that each measure notices, and
    whether all effects together bring the simulation nearer."""
    lines = []
    plain = group[group["simulation"] == PLAIN]
    outside = [
        NAMES[c.measure] for c in plain.itertuples() if not c.halves_low <= c.value <= c.halves_high
    ]
    clause = f"{_listed(outside)} tell" if len(outside) > 1 else f"{_listed(outside)} tells"
    lines.append(f"- {clause} the plain simulation from another half of the recording.")
    single_effects = group[~group["simulation"].isin([PLAIN, ALL])]
    for measure, cells in single_effects.groupby("measure", sort=False):
        noticed = [
            f"{c.simulation} ({c.direction})" for c in cells.itertuples() if c.notices == "yes"
        ]
        missed = [c.simulation for c in cells.itertuples() if c.notices == "no"]
        remainder = f"; not {_listed(missed)}" if missed else ", every one"
        lines.append(f"- {NAMES[measure]} notices {_listed(noticed)}{remainder}.")
    all_rows = group[group["simulation"] == ALL]
    measures_by_direction = {
        word: _listed([NAMES[c.measure] for c in all_rows.itertuples() if c.direction == direction])
        for word, direction in (("nearer", "nearer"), ("farther", "farther"), ("the same", ""))
    }
    clause = "; ".join(f"{word} by {names}" for word, names in measures_by_direction.items())
    lines.append(f"- All effects together, against plain: {clause}.")
    plain_row, all_row = (group[group["simulation"] == s].iloc[0] for s in (PLAIN, ALL))
    within_change = all_row["mmd_within_simulation"] - plain_row["mmd_within_simulation"]
    recording_change = all_row["mmd_within_recording"] - plain_row["mmd_within_recording"]
    across_change = -2.0 * (all_row["mmd_across"] - plain_row["mmd_across"])
    lines.append(
        f"- Of MMD's change from plain to all, {all_row['change']:+.2f}, the simulated frames' "
        f"likeness to one another makes {within_change:+.2f}, that of the recorded ones "
        f"{recording_change:+.2f}, and the likeness between the two sets {across_change:+.2f}: "
        "only the last is nearness."
    )
    return lines


def _listed(names: list[str]) -> str:
    return listed(names) or "none"
