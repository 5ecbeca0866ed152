"""The simulated sets: clean physics, then effects stage by stage, then noise, session by session.

As in the paper's code, the untouched frame carries the instrument of its touched frame's force.
"""

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin import cores
from eitskin.data import dataset
from eitskin.data.baseline import untouched_noise
from eitskin.effects.effect import Frames, Setting
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.rim_curve import RimCurve
from eitskin.physics.skin import Skin
from eitskin.progress import patient
from eitskin.simulate import stages, state_priors
from eitskin.simulate.readings import apply_instrument, simulate
from eitskin.simulate.stages import Part, Stage

SESSIONS = 8  # simulated by one process at a time
NOISE = zlib.crc32(b"noise")
NOISE_SAMPLES = 65_536  # or a few more, of untouched changes, for the noise in the metadata
CONTINUOUS = "-continuous"  # suffix of a set with continuously distributed touches


def sessions(
    places: int, levels: int, session_frames: int, crossed: bool, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Session, place and level (each (places * levels,) int) of every sample.

    Location-major, `session_frames` at a time, as in the paper. crossed: every session presses all
    places, with as many levels at each as fill `session_frames`, in a random order for each place.
    """
    place = np.repeat(np.arange(places), levels)
    level = np.tile(np.arange(levels), places)
    if not crossed:
        return np.arange(places * levels) // session_frames, place, level
    per_place = max(session_frames // places, 1)
    rng = np.random.default_rng([seed, 2])
    order = np.concatenate([rng.permutation(levels) for _ in range(places)])
    session = np.tile(np.arange(levels) // per_place, places)
    by_session = np.argsort(session, kind="stable")
    return session[by_session], place[by_session], order[by_session]


def continuous_samples(
    samples: int,
    session_frames: int,
    seed: int,
    reach_mm: float | None,
    probe_mm: float,
    forces: dict,
    margin_mm: float = 0.0,
    rim: RimCurve | None = None,
) -> pd.DataFrame:
    """Samples with a random place and force each, `session_frames` a session.

    Places are uniform over the disc of radius `reach_mm`, or over what lies `margin_mm` or more
    within a rim; forces (mean_N, sd_N, max_N) are normal and clipped, not rounded.
    """
    normal = np.random.default_rng([seed, 3]).standard_normal((samples, 3))
    index = np.arange(samples, dtype=np.int64)
    if rim is None:
        assert reach_mm is not None
        xy = state_priors.place_mm(normal[:, :2], reach_mm)
    else:
        places_rng = np.random.default_rng([seed, 6])
        xy = state_priors.place_within(places_rng, samples, rim, margin_mm)
    return pd.DataFrame(
        {
            "sample": index,
            "session": index // session_frames,
            "place": index,
            "x_mm": xy[:, 0],
            "y_mm": xy[:, 1],
            "force_N": state_priors.force_N(normal[:, 2], **forces),
            "probe_mm": probe_mm,
        }
    )


def _grid_samples(
    grid: pd.DataFrame,
    force_N: np.ndarray,
    session: np.ndarray,
    place: np.ndarray,
    level: np.ndarray,
) -> pd.DataFrame:
    sample_places = grid.iloc[place]
    return pd.DataFrame(
        {
            "sample": np.arange(len(place), dtype=np.int64),
            "session": np.asarray(session, dtype=np.int64),
            "place": sample_places["place"].to_numpy(np.int64),
            "x_mm": sample_places["x_mm"].to_numpy(),
            "y_mm": sample_places["y_mm"].to_numpy(),
            "force_N": force_N[level],
            "probe_mm": 2.0 * sample_places["radius_mm"].to_numpy(),
        }
    )


def sample_settings(
    effects: list[dict], counts: dict[str, int], draw: tuple[int, ...]
) -> list[Setting]:
    """The settings of these effects. Raises InputError also for effects that need time, which a
    sample does not have."""
    effect_settings = settings(effects, counts, draw)
    for setting in effect_settings:
        effect = setting.effect
        if effect.stage == "clock" or effect.driver in ("time", "load-direction"):
            expected = "an effect on single samples; this one needs a recording"
            raise InputError(f"effect {effect.name}", "name", repr(effect.name), expected)
    return effect_settings


def _laid_out(
    mesh: str | Path, touch_grid: str | Path
) -> tuple[np.ndarray, np.ndarray, pd.DataFrame]:
    """Channels (M, 4), force levels and the grid of places."""
    with np.load(mesh) as laid:
        lengths = dict.fromkeys(("x_mm", "y_mm", "radius_mm"), float)  # whole numbers as well
        return laid["channels"], laid["force_N"], pd.read_csv(touch_grid, dtype=lengths)


def _write_sessions(
    path: str | Path,
    table: pd.DataFrame,
    channels: np.ndarray,
    skin: dict,
    accuracy: str,
    settings_of: Callable[[int, np.ndarray], list[Setting]],
) -> None:
    believed = Skin.from_metadata(skin, "config.yaml")
    untouched_row = pd.DataFrame({"touch": [False], "force_N": [0.0]})
    force_max_N = table["force_N"].max()

    def simulated(session: int, rows: slice) -> np.ndarray:
        frames = pd.concat([untouched_row, table.iloc[rows].assign(touch=True)], ignore_index=True)
        return simulate(
            frames.assign(time_s=0.0),
            np.arange(-1, len(frames) - 1),
            believed,
            channels,
            settings_of(session, channels),
            accuracy,
            force_max_N=force_max_N,
        ).astype(np.float32)

    def parts() -> Iterator[Part]:
        all_sessions = list(stages.sessions(table))
        batch_size = SESSIONS * cores.at_once()
        for start in patient(
            range(0, len(all_sessions), batch_size), f"groups of {batch_size} sessions"
        ):
            batch = all_sessions[start : start + batch_size]
            voltages = cores.spread(lambda session_rows: simulated(*session_rows), batch)
            for (_, rows), voltage in zip(batch, voltages, strict=True):
                session_table = table.iloc[rows]
                yield Part(
                    session_table, np.repeat(voltage[:1], len(session_table), axis=0), voltage[1:]
                )

    stages.write(path, parts(), channels, force_max_N)


def write_clean(
    mesh: str | Path, touch_grid: str | Path, path: str | Path, skin: dict, accuracy: str
) -> None:
    """Write every place and force on the ideal skin as a stage."""
    channels, force_N, grid = _laid_out(mesh, touch_grid)
    places, levels = len(grid), len(force_N)
    layout = sessions(places, levels, places * levels, False, 0)

    def nothing(session: int, channels: np.ndarray) -> list[Setting]:
        return []

    table = _grid_samples(grid, force_N, *layout)
    _write_sessions(path, table, channels, skin, accuracy, nothing)


@dataclass(frozen=True)
class SkinStage:
    """What the stage of the skin is simulated from, by the names of the configuration.

    effects: those that need a forward solve, drawn anew for each session; session_frames and
    crossed as for `sessions`; continuous: reach_mm (null for an outline, which has margin_mm),
    probe_mm and forces of `continuous_samples`, which replace the grid, and `samples`, by default
    as many as the grid has.
    """

    seed: int
    skin: dict
    accuracy: str
    effects: list[dict]
    session_frames: int
    crossed: bool
    continuous: dict | None = None


def write_skin_stage(
    mesh: str | Path, touch_grid: str | Path, path: str | Path, stage: SkinStage
) -> None:
    """Write the stage of the skin: every place and force, or continuously distributed ones."""
    channels, force_N, grid = _laid_out(mesh, touch_grid)
    seed, session_frames = stage.seed, stage.session_frames
    if stage.continuous:
        as_many = {"samples": len(grid) * len(force_N)}
        table = continuous_samples(
            **(as_many | stage.continuous),
            session_frames=session_frames,
            seed=seed,
            rim=Skin.from_metadata(stage.skin, "config.yaml").rim,
        )
    else:
        layout = sessions(len(grid), len(force_N), session_frames, stage.crossed, seed)
        table = _grid_samples(grid, force_N, *layout)

    def settings_of(session: int, channels: np.ndarray) -> list[Setting]:
        return sample_settings(stage.effects, site_counts(channels), (seed, session, 0))

    _write_sessions(path, table, channels, stage.skin, stage.accuracy, settings_of)


def write_stage(
    stage: str | Path, path: str | Path, seed: int, effect: dict, position: int
) -> None:
    """Apply one instrument effect, drawn anew for each session, to a stage."""
    source = Stage(stage)
    channels, force_max_N = source.channels, source.force_max_N

    def parts() -> Iterator[Part]:
        for part in patient(source, "parts"):
            force = part.table["force_N"].to_numpy()
            for session, rows in stages.sessions(part.table):
                effect_settings = sample_settings(
                    [effect], site_counts(channels), (seed, session, position)
                )
                session_force = force[rows]
                frames = Frames(
                    np.zeros(len(session_force)), session_force, channels, force_max_N=force_max_N
                )
                for voltage in part[1:]:
                    voltage[rows] = apply_instrument(
                        voltage[rows].astype(float), effect_settings, frames
                    )
            yield part

    stages.write(path, parts(), channels, force_max_N)


def write_dataset(
    stage: str | Path,
    path: str | Path,
    configuration: str,
    seed: int,
    noise: float,
    baseline: str,
) -> None:
    """Add noise to untouched and touched frames, `noise` times the median |v| of the frame, and
    write their difference.

    baseline "paired": every sample has its own untouched frame; "averaged": the noise of the
    untouched frames is averaged over the session, as by a lab that averages its baseline.
    """
    source = Stage(stage)

    def noisy(part: Part) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        for session, rows in stages.sessions(part.table):
            yield rows, *_noisy(part, rows, (seed, session, NOISE), noise, baseline)

    untouched_changes: list[np.ndarray] = []
    for part in source:
        if sum(map(len, untouched_changes)) >= NOISE_SAMPLES:
            break
        untouched_changes += [untouched_change for _, _, untouched_change in noisy(part)]
    metadata = {
        "format": "eitskin-dataset",
        "version": 1,
        "name": f"simulated-{configuration}",
        "origin": "simulated",
        "configuration": configuration.removesuffix(CONTINUOUS),
        "targets": ["x", "y", "F"],
        "unit": "V",
        "voltage": "signed",
        "position_frame": "skin",
        "channels": source.channels.tolist(),
        "noise": noise,
        "baseline": baseline,
        "untouched": untouched_noise(np.concatenate(untouched_changes).astype(float)),
    }
    untouched_changes.clear()

    def parts() -> Iterator[tuple[pd.DataFrame, np.ndarray]]:
        for part in source:
            change = np.empty(part.touched.shape, dtype=np.float32)
            for rows, session_change, _ in noisy(part):
                change[rows] = session_change
            yield part.table.assign(depth_mm=np.nan), change

    dataset.write_parts(parts(), metadata, path)


def _noisy(
    part: Part, rows: slice, draw: tuple[int, ...], noise: float, baseline: str
) -> tuple[np.ndarray, np.ndarray]:
    """Changes (n, M) of a session's samples, and float32 changes of an untouched frame."""
    rng = np.random.default_rng(draw)
    noisy_frames = []
    for voltage in part[1:]:
        values = voltage[rows].astype(float)
        scale = noise * np.median(np.abs(values), axis=1, keepdims=True)
        noisy_frames.append((values, scale * rng.standard_normal(values.shape)))
    (base, base_noise), (touch, touch_noise) = noisy_frames
    if baseline == "averaged":
        base_noise = base_noise.mean(axis=0)
    untouched_change = scale * rng.standard_normal(base.shape) - base_noise
    return touch + touch_noise - base - base_noise, untouched_change.astype(np.float32)
