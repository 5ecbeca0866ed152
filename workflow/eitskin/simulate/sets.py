"""The simulated sets: clean physics, then effects stage by stage, then noise, session by session.

As in the paper's code, the untouched frame carries the instrument of its touched frame's force.
"""

import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin import cores
from eitskin.data import dataset
from eitskin.data.baseline import untouched_noise
from eitskin.effects.effect import Frames, Setting
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.skin import Skin
from eitskin.progress import patient
from eitskin.simulate import stages, state_priors
from eitskin.simulate.readings import apply_instrument, simulate
from eitskin.simulate.stages import Part, Stage

SESSIONS = 8  # that a process simulates at a time
NOISE = zlib.crc32(b"noise")
NOISE_SAMPLES = 65_536  # from which the noise of an untouched frame's change is told, or a few more
CONTINUOUS = "-continuous"  # so ends the name of a set whose touches lie everywhere


def sessions(
    places: int, levels: int, session_frames: int, crossed: bool, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Session, place and level (each (places * levels,) int) of every sample.

    Location-major, `session_frames` at a time, as the paper; crossed: every session presses all
    places, as many levels at each as fill `session_frames`, in an order drawn for each place.
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
    samples: int, session_frames: int, seed: int, reach_mm: float, probe_mm: float, forces: dict
) -> pd.DataFrame:
    """Samples each with a place and a force of its own, `session_frames` a session.

    Places lie evenly over the disc of radius `reach_mm`; forces (mean_N, sd_N, max_N) are normal,
    clipped, not rounded.
    """
    normal = np.random.default_rng([seed, 3]).standard_normal((samples, 3))
    own = np.arange(samples, dtype=np.int64)
    xy = state_priors.place_mm(normal[:, :2], reach_mm)
    return pd.DataFrame(
        {
            "sample": own,
            "session": own // session_frames,
            "place": own,
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
    chosen = grid.iloc[place]
    return pd.DataFrame(
        {
            "sample": np.arange(len(place), dtype=np.int64),
            "session": np.asarray(session, dtype=np.int64),
            "place": chosen["place"].to_numpy(np.int64),
            "x_mm": chosen["x_mm"].to_numpy(),
            "y_mm": chosen["y_mm"].to_numpy(),
            "force_N": force_N[level],
            "probe_mm": 2.0 * chosen["radius_mm"].to_numpy(),
        }
    )


def sample_settings(
    items: list[dict], counts: dict[str, int], draw: tuple[int, ...]
) -> list[Setting]:
    """As `settings`; InputError also for effects that a sample, which has no time, cannot show."""
    chosen = settings(items, counts, draw)
    for setting in chosen:
        effect = setting.effect
        if effect.stage == "clock" or effect.driver in ("time", "load-direction"):
            expected = "an effect on single samples; this one needs a recording"
            raise InputError(f"effect {effect.name}", "name", repr(effect.name), expected)
    return chosen


def _laid_out(
    mesh: str | Path, touch_grid: str | Path
) -> tuple[np.ndarray, np.ndarray, pd.DataFrame]:
    """Channels (M, 4), force levels and the grid of places."""
    with np.load(mesh) as laid:
        return laid["channels"], laid["force_N"], pd.read_csv(touch_grid)


def _write_sessions(
    out: str | Path,
    table: pd.DataFrame,
    channels: np.ndarray,
    skin: dict,
    accuracy: str,
    chosen_of: Callable[[int, np.ndarray], list[Setting]],
) -> None:
    believed = Skin.from_metadata(skin, "config.yaml")
    still = pd.DataFrame({"touch": [False], "force_N": [0.0]})
    force_max_N = table["force_N"].max()

    def simulated(session: int, rows: slice) -> np.ndarray:
        frames = pd.concat([still, table.iloc[rows].assign(touch=True)], ignore_index=True)
        return simulate(
            frames.assign(time_s=0.0),
            np.arange(-1, len(frames) - 1),
            believed,
            channels,
            chosen_of(session, channels),
            accuracy,
            force_max_N=force_max_N,
        ).astype(np.float32)

    def parts() -> Iterator[Part]:
        every = list(stages.sessions(table))
        several = SESSIONS * cores.at_once()
        for start in patient(range(0, len(every), several), f"groups of {several} sessions"):
            some = every[start : start + several]
            found = cores.spread(lambda one: simulated(*one), some)
            for (_, rows), voltage in zip(some, found, strict=True):
                own = table.iloc[rows]
                yield Part(own, np.repeat(voltage[:1], len(own), axis=0), voltage[1:])

    stages.write(out, parts(), channels, force_max_N)


def write_clean(
    mesh: str | Path, touch_grid: str | Path, out: str | Path, skin: dict, accuracy: str
) -> None:
    """Every place and force on the ideal skin, as a stage."""
    channels, force_N, grid = _laid_out(mesh, touch_grid)
    places, levels = len(grid), len(force_N)
    layout = sessions(places, levels, places * levels, False, 0)

    def nothing(session: int, channels: np.ndarray) -> list[Setting]:
        return []

    table = _grid_samples(grid, force_N, *layout)
    _write_sessions(out, table, channels, skin, accuracy, nothing)


def write_skin_stage(
    mesh: str | Path,
    touch_grid: str | Path,
    out: str | Path,
    seed: int,
    skin: dict,
    accuracy: str,
    effects: list[dict],
    session_frames: int,
    crossed: bool,
    continuous: dict | None = None,
) -> None:
    """Every place and force with the effects that need a forward solve, drawn anew for each
    session, as a stage.

    continuous: reach_mm, probe_mm and forces of `continuous_samples`, in place of the grid; and
    `samples`, where they are not as many as the grid has.
    """
    channels, force_N, grid = _laid_out(mesh, touch_grid)
    if continuous:
        as_many = {"samples": len(grid) * len(force_N)}
        table = continuous_samples(
            **(as_many | continuous), session_frames=session_frames, seed=seed
        )
    else:
        layout = sessions(len(grid), len(force_N), session_frames, crossed, seed)
        table = _grid_samples(grid, force_N, *layout)

    def chosen_of(session: int, channels: np.ndarray) -> list[Setting]:
        return sample_settings(effects, site_counts(channels), (seed, session, 0))

    _write_sessions(out, table, channels, skin, accuracy, chosen_of)


def write_stage(stage: str | Path, out: str | Path, seed: int, effect: dict, position: int) -> None:
    """One instrument effect, drawn anew for each session, applied to a stage."""
    before = Stage(stage)
    channels, most = before.channels, before.force_max_N

    def parts() -> Iterator[Part]:
        for part in patient(before, "parts"):
            force = part.table["force_N"].to_numpy()
            for session, rows in stages.sessions(part.table):
                chosen = sample_settings([effect], site_counts(channels), (seed, session, position))
                own = force[rows]
                frames = Frames(np.zeros(len(own)), own, channels, force_max_N=most)
                for voltage in part[1:]:
                    voltage[rows] = apply_instrument(voltage[rows].astype(float), chosen, frames)
            yield part

    stages.write(out, parts(), channels, most)


def write_dataset(
    stage: str | Path,
    out: str | Path,
    configuration: str,
    seed: int,
    noise: float,
    baseline: str,
) -> None:
    """Noise on untouched and touched frame, `noise` times each frame's median |v|; their
    difference.

    baseline "paired": each sample its own untouched frame; "averaged": the noise of the untouched
    frames averaged over the session, as by a lab that averages its baseline.
    """
    before = Stage(stage)

    def noisy(part: Part) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        for session, rows in stages.sessions(part.table):
            yield rows, *_noisy(part, rows, (seed, session, NOISE), noise, baseline)

    still: list[np.ndarray] = []
    for part in before:
        if sum(map(len, still)) >= NOISE_SAMPLES:
            break
        still += [apart for _, _, apart in noisy(part)]
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
        "channels": before.channels.tolist(),
        "noise": noise,
        "baseline": baseline,
        "untouched": untouched_noise(np.concatenate(still).astype(float)),
    }
    still.clear()

    def parts() -> Iterator[tuple[pd.DataFrame, np.ndarray]]:
        for part in before:
            change = np.empty(part.touched.shape, dtype=np.float32)
            for rows, own, _ in noisy(part):
                change[rows] = own
            yield part.table.assign(depth_mm=np.nan), change

    dataset.write_parts(parts(), metadata, out)


def _noisy(
    part: Part, rows: slice, draw: tuple[int, ...], noise: float, baseline: str
) -> tuple[np.ndarray, np.ndarray]:
    """The changes (n, M) of a session's samples, and float32 changes of an untouched frame."""
    rng = np.random.default_rng(draw)
    noisy = []
    for voltage in part[1:]:
        values = voltage[rows].astype(float)
        scale = noise * np.median(np.abs(values), axis=1, keepdims=True)
        noisy.append((values, scale * rng.standard_normal(values.shape)))
    (base, base_noise), (touch, touch_noise) = noisy
    if baseline == "averaged":
        base_noise = base_noise.mean(axis=0)
    still = scale * rng.standard_normal(base.shape) - base_noise
    return touch + touch_noise - base - base_noise, still.astype(np.float32)
