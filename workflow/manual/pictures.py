"""A picture of every effect: what it changes in the readings of the twin's skin in `config.yaml`.

Each parameter is a typical change away from the value at which it does nothing, as a diagnosis has
it, or at a value from which its fits start.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from eitskin.atomic import atomic_path
from eitskin.diagnose.fitting.candidates import Candidate, Scales
from eitskin.diagnose.report.figures import draw_change, scale
from eitskin.diagnose.verdict.words import sites
from eitskin.effects import EFFECTS
from eitskin.effects.effect import Effect, LeakEffect, Setting
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.plotting import SEQUENTIAL, column, draw_matrix, matrix, png, style
from eitskin.quantities import prefixed, quantity
from eitskin.simulate.readings import simulate
from manual.keys import DEFAULTS

SITE = 6  # the electrode, drive or pair that is the culprit, where there is one
PLACE, PROBE_MM, FRAME_S = (30.0, 25.0), 10.0, 0.35
PROBE = f"a probe of {PROBE_MM:g} mm at x = {PLACE[0]:g} mm, y = {PLACE[1]:g} mm"
# A press and what is before and after it: s, N, and what the skin meets then.
PRESS = (
    (0.0, 0.0, "untouched"),
    (10.0, 4.0, f"{PROBE} passes 4 N, the force rising by 8 N/s"),
    (10.5, 8.0, f"{PROBE} has just reached 8 N"),
    (40.5, 8.0, f"{PROBE} has held 8 N for 30 s"),
    (41.0, 4.0, f"{PROBE} is back at 4 N after 8 N"),
    (3600.0, 0.0, "untouched, an hour after the first frame"),
)
FIRST_TRIED = (0, 2, 1, 3, 4, 5)  # of PRESS: an effect is drawn in the first in which it shows
SHOWS = 0.3  # of its largest change over PRESS
OF_A_TOUCH = ("force", "position", "load-direction")  # what only a touch gives sense to
GIVEN = {  # where the first of the values from which fits start is no example
    "conductivity-patch": {"x_mm": 40.0, "y_mm": 30.0, "radius_mm": 12.0},
    "domain-shape": {"harmonic": 3.0},
    "mains-interference": {"frequency_Hz": 50.0},
    "relaxation": {"tau_s": 3.0},
    "third-dimension": {"electrode_height_mm": 1.0, "electrode_z_mm": 0.5},
}


@dataclass(frozen=True)
class Picture:
    """What an effect changes in one frame: change (M,) V, and beside it beside (M,) V, the frame's
    readings without it, or what a touch changes in them; channels (M, 4); caption: in words."""

    channels: np.ndarray
    beside: np.ndarray
    change: np.ndarray
    of_touch: bool
    caption: str


def picture(effect: Effect) -> Picture:
    """What an effect changes in the first frame of PRESS in which it shows."""
    skin, channels = _twin()
    states, grounded = _states(), isinstance(effect, LeakEffect)

    def readings(chosen: list[Setting]) -> np.ndarray:
        press = states["touch"].to_numpy(int) - 1
        return simulate(states, press, skin, channels, chosen, "train", FRAME_S, grounded)

    plain = readings([])
    setting = _typical(effect, skin, plain, channels)
    change = readings([setting]) - plain
    if not change.any():
        expected = "a change of some reading; give GIVEN values at which it shows"
        raise InputError("workflow/manual/pictures.py", effect.name, "no change", expected)
    frame = _shown(effect, change)
    of_touch = effect.stage in ("touch", "clock")
    beside = plain[frame] - plain[0] if of_touch else plain[frame]
    left = "what the touch alone changes" if of_touch else "size of the readings without the effect"
    caption = (
        f"Left, {_unit(beside)[1]}: {left}. Right, {_unit(change[frame])[1]}: what the effect"
        f" changes{_at(setting)}. The frame: {PRESS[frame][2]}."
    )
    if grounded:
        caption += " The source's sink is at ground."
    return Picture(channels, beside, change[frame], of_touch, caption)


@cache
def _twin() -> tuple[Skin, np.ndarray]:
    """The twin's skin and its channels (M, 4)."""
    twin = yaml.safe_load(DEFAULTS.read_text(encoding="utf-8"))["twin"]
    channels = channel_table(len(twin["skin"]["electrode_deg"]), **twin["protocol"])
    return Skin.from_metadata(twin["skin"]), channels


def _states() -> pd.DataFrame:
    time_s, force_N, _ = zip(*PRESS, strict=True)
    touch = np.array(force_N) > 0
    where = {"x_mm": PLACE[0], "y_mm": PLACE[1], "probe_mm": PROBE_MM}
    known = {key: np.where(touch, value, np.nan) for key, value in where.items()}
    return pd.DataFrame({"time_s": time_s, "touch": touch, "force_N": force_N, **known})


def _typical(effect: Effect, skin: Skin, plain: np.ndarray, channels: np.ndarray) -> Setting:
    """The effect at one site, its first parameter a typical change away from nothing."""
    kind = effect.sites[0] if effect.sites else None
    chosen = None
    if kind is not None:
        first = int(np.flatnonzero(channels[:, 0] == SITE)[SITE]) if kind == "channels" else SITE
        chosen = tuple(first + k for k in range(effect.sites_at_once(floating=False)))
    start = effect.starts(skin, plain)[0] | GIVEN.get(effect.name, {})
    assert skin.current_A is not None
    scales = Scales(float(np.median(np.abs(plain[0]))), skin.current_A)
    scope = "sparse" if effect.sites else ""
    candidate = Candidate(effect, kind, chosen, scope, start, skin, scales)
    coordinates = np.zeros(candidate.size)
    coordinates[np.flatnonzero(candidate.linear)[:1]] = 1.0
    return candidate.setting(coordinates)


def _shown(effect: Effect, change: np.ndarray) -> int:
    """The frame of change (N, M) that is drawn."""
    size = np.sqrt((change**2).mean(axis=1))
    tried = [k for k in FIRST_TRIED if effect.driver not in OF_A_TOUCH or PRESS[k][1] > 0]
    return next(k for k in tried if size[k] >= SHOWS * size[tried].max())


def _at(setting: Setting) -> str:
    """An effect's site and values in brackets, where there are any."""
    parts = [] if setting.sites is None else [sites({setting.kind: setting.sites.tolist()})]
    parts += [
        f"`{key}` = {quantity(float(np.ravel(value)[0]), setting.effect.parameters[key].unit)}"
        for key, value in setting.values.items()
        if value is not None
    ]
    return f" ({', '.join(parts)})" if parts else ""


def draw(shown: Picture) -> Figure:
    """The picture of an effect, as wide as a column."""
    with style():
        figure = column(52)
        left, right = figure.subplots(1, 2)
        left.set_title("the touch's change" if shown.of_touch else "size of the readings")
        right.set_title("the effect's change")
        left.set_ylabel("drive, source electrode")
        factor, unit = _unit(shown.beside)
        if shown.of_touch:
            draw_change(figure, left, shown.channels, shown.beside / factor, unit)
        else:
            cells = matrix(shown.channels, np.abs(shown.beside) / factor)
            norm = LogNorm(np.nanmin(cells), np.nanmax(cells))
            image = draw_matrix(left, shown.channels, cells, norm, SEQUENTIAL)
            left.invert_yaxis()
            scale(figure, left, image, unit)
        factor, unit = _unit(shown.change)
        draw_change(figure, right, shown.channels, shown.change / factor, unit)
    return figure


def _unit(volt: np.ndarray) -> tuple[float, str]:
    """By what (M,) V are divided, and the unit that they have then."""
    return prefixed(float(np.abs(volt).max()), "V")


def write(folder: Path) -> None:
    """Write NAME.png of every effect of the catalogue into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, effect in EFFECTS.items():
        with atomic_path(folder / f"{name}.png") as path:
            path.write_bytes(png(draw(picture(effect))))
