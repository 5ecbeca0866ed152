"""A picture of every effect: its changes of the readings of the twin's skin in `config.yaml`.

The first parameter is a typical change away from the value without effect, as in a diagnosis; the
others are at values from which fits start.
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
from eitskin.diagnose.report.figures import draw_change_matrix, draw_scale
from eitskin.diagnose.verdict.words import sites_text
from eitskin.effects import EFFECTS
from eitskin.effects.effect import Effect, LeakEffect, Setting
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.plotting import SEQUENTIAL, column, draw_matrix, matrix, png, style
from eitskin.quantities import prefixed, quantity
from eitskin.simulate.readings import simulate
from manual.keys import DEFAULTS

SITE = 6  # the electrode, drive or pair of an effect with a site
PLACE, PROBE_MM, FRAME_S = (30.0, 25.0), 10.0, 0.35
PROBE = f"a probe of {PROBE_MM:g} mm at x = {PLACE[0]:g} mm, y = {PLACE[1]:g} mm"
# Frames before, during and after a press: s, N, and the state in words.
PRESS = (
    (0.0, 0.0, "untouched"),
    (10.0, 4.0, f"{PROBE} passes 4 N, the force rising by 8 N/s"),
    (10.5, 8.0, f"{PROBE} has just reached 8 N"),
    (40.5, 8.0, f"{PROBE} has held 8 N for 30 s"),
    (41.0, 4.0, f"{PROBE} is back at 4 N after 8 N"),
    (3600.0, 0.0, "untouched, an hour after the first frame"),
)
FRAME_ORDER = (0, 2, 1, 3, 4, 5)  # of PRESS: an effect is drawn in the first frame that shows it
SHOWS = 0.3  # of an effect's largest change over PRESS, from which on a frame shows it
TOUCH_DRIVERS = ("force", "position", "load-direction")  # drivers that need a touch
EXAMPLES = {  # where the first of a fit's starting values makes no clear picture
    "conductivity-patch": {"x_mm": 40.0, "y_mm": 30.0, "radius_mm": 12.0},
    "domain-shape": {"harmonic": 3.0},
    "mains-interference": {"frequency_Hz": 50.0},
    "relaxation": {"tau_s": 3.0},
    "third-dimension": {"electrode_height_mm": 1.0, "electrode_z_mm": 0.5},
}


@dataclass(frozen=True)
class Picture:
    """The changes (M,) V of one frame by an effect, and for comparison (M,) V the frame's readings
    without it, or their changes by the touch; channels (M, 4); the caption."""

    channels: np.ndarray
    comparison: np.ndarray
    change: np.ndarray
    of_touch: bool
    caption: str


def picture(effect: Effect) -> Picture:
    """The picture of an effect in the first frame of FRAME_ORDER that shows it."""
    skin, channels = _twin()
    states, grounded = _states(), isinstance(effect, LeakEffect)

    def readings(settings: list[Setting]) -> np.ndarray:
        press = states["touch"].to_numpy(int) - 1
        return simulate(states, press, skin, channels, settings, "train", FRAME_S, grounded)

    plain = readings([])
    setting = _typical(effect, skin, plain, channels)
    change = readings([setting]) - plain
    if not change.any():
        expected = "a change of some reading; give GIVEN values at which it shows"
        raise InputError("workflow/manual/pictures.py", effect.name, "no change", expected)
    frame = _drawn_frame(effect, change)
    of_touch = effect.stage in ("touch", "clock")
    beside = plain[frame] - plain[0] if of_touch else plain[frame]
    left_panel = (
        "what the touch alone changes" if of_touch else "size of the readings without the effect"
    )
    caption = (
        f"Left, {_unit(beside)[1]}: {left_panel}. Right, {_unit(change[frame])[1]}: what the effect"
        f" changes{_values_text(setting)}. The frame: {PRESS[frame][2]}."
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
    press_columns = {"x_mm": PLACE[0], "y_mm": PLACE[1], "probe_mm": PROBE_MM}
    touch_columns = {key: np.where(touch, value, np.nan) for key, value in press_columns.items()}
    return pd.DataFrame({"time_s": time_s, "touch": touch, "force_N": force_N, **touch_columns})


def _typical(effect: Effect, skin: Skin, plain: np.ndarray, channels: np.ndarray) -> Setting:
    """The effect at one site, its first parameter a typical change away from no effect."""
    kind = effect.sites[0] if effect.sites else None
    site_numbers = None
    if kind is not None:
        start_site = (
            int(np.flatnonzero(channels[:, 0] == SITE)[SITE]) if kind == "channels" else SITE
        )
        site_numbers = tuple(start_site + k for k in range(effect.sites_at_once(floating=False)))
    values = effect.starts(skin, plain)[0] | EXAMPLES.get(effect.name, {})
    assert skin.current_A is not None
    scales = Scales(float(np.median(np.abs(plain[0]))), skin.current_A)
    scope = "sparse" if effect.sites else ""
    candidate = Candidate(effect, kind, site_numbers, scope, values, skin, scales)
    coordinates = np.zeros(candidate.size)
    coordinates[np.flatnonzero(candidate.linear)[:1]] = 1.0
    return candidate.setting(coordinates)


def _drawn_frame(effect: Effect, change: np.ndarray) -> int:
    """The number of the drawn frame, from changes (N, M)."""
    size = np.sqrt((change**2).mean(axis=1))
    frames = [k for k in FRAME_ORDER if effect.driver not in TOUCH_DRIVERS or PRESS[k][1] > 0]
    return next(k for k in frames if size[k] >= SHOWS * size[frames].max())


def _values_text(setting: Setting) -> str:
    """The site and values of an effect in brackets, empty without any."""
    parts = [] if setting.sites is None else [sites_text({setting.kind: setting.sites.tolist()})]
    parts += [
        f"`{key}` = {quantity(float(np.ravel(value)[0]), setting.effect.parameters[key].unit)}"
        for key, value in setting.values.items()
        if value is not None
    ]
    return f" ({', '.join(parts)})" if parts else ""


def draw(effect_picture: Picture) -> Figure:
    """The picture of an effect, as wide as a column."""
    with style():
        figure = column(52)
        left_axes, right_axes = figure.subplots(1, 2)
        left_axes.set_title(
            "the touch's change" if effect_picture.of_touch else "size of the readings"
        )
        right_axes.set_title("the effect's change")
        left_axes.set_ylabel("drive, source electrode")
        factor, unit = _unit(effect_picture.comparison)
        if effect_picture.of_touch:
            draw_change_matrix(
                figure, left_axes, effect_picture.channels, effect_picture.comparison / factor, unit
            )
        else:
            cells = matrix(effect_picture.channels, np.abs(effect_picture.comparison) / factor)
            norm = LogNorm(np.nanmin(cells), np.nanmax(cells))
            image = draw_matrix(left_axes, effect_picture.channels, cells, norm, SEQUENTIAL)
            left_axes.invert_yaxis()
            draw_scale(figure, left_axes, image, unit)
        factor, unit = _unit(effect_picture.change)
        draw_change_matrix(
            figure, right_axes, effect_picture.channels, effect_picture.change / factor, unit
        )
    return figure


def _unit(volt: np.ndarray) -> tuple[float, str]:
    """The divisor of values (M,) V, and their unit after the division."""
    return prefixed(float(np.abs(volt).max()), "V")


def write(folder: Path) -> None:
    """Write NAME.png of every effect of the catalogue into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, effect in EFFECTS.items():
        with atomic_path(folder / f"{name}.png") as path:
            path.write_bytes(png(draw(picture(effect))))
