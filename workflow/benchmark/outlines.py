"""The forward model on outlines that are no discs, against finite elements that share nothing with
it.

    python -m benchmark.outlines [OUTLINE …]

computes all rows, or those of some outlines anew.
"""

import sys
import time
from dataclasses import replace

import numpy as np
import pandas as pd

from benchmark.rows import ROOT
from eitskin.atomic import atomic_path
from eitskin.errors import InputError
from eitskin.physics.forward import ACCURACIES, Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.rim_curve import RimCurve
from eitskin.progress import patient
from witness.outline_cases import (
    CONDUCTIVITY_S_PER_M,
    NAMES,
    THICKNESS_MM,
    OutlineCase,
    adjacent_channels,
    outline_case,
)
from witness.outline_skin import InnerElectrode, RimElectrode

CSV = ROOT / "benchmarks" / "outlines.csv"
SMOOTH_POINTS = 1000  # through which a curve of the witness is drawn
# The same outlines with their electrodes turned until one is centred at the first corner.
ROUND_CORNERS = {f"{name}, round corners": name for name in ("square", "L", "flat disc")}
ROWS = (*NAMES, *ROUND_CORNERS)


def case(name: str) -> OutlineCase:
    """One of ROWS. Raises KeyError for another."""
    if name not in ROUND_CORNERS:
        return outline_case(name)
    even = outline_case(ROUND_CORNERS[name])
    on_rim = [e for e in even.electrodes if isinstance(e, RimElectrode)]
    electrodes = tuple(replace(e, share=(e.share - on_rim[0].share) % 1.0) for e in on_rim)
    return replace(even, name=name, electrodes=electrodes)


def geometry(skin: OutlineCase) -> Geometry:
    """The skin as the forward model takes it. Raises InputError for what it does not model."""
    definition, electrodes = skin.definition, skin.electrodes
    if definition["kind"] == "polygon":
        rim = RimCurve(tuple(map(tuple, definition["corners_mm"])))
    else:
        even = np.arange(SMOOTH_POINTS) / SMOOTH_POINTS
        points = skin.outline.place(np.union1d(even, skin.outline.ends[skin.outline.corners]))
        rim = RimCurve(tuple(zip(points.real, points.imag, strict=True)), smooth=True)
    return Geometry(
        rim.perimeter_mm / (2.0 * np.pi),
        THICKNESS_MM,
        CONDUCTIVITY_S_PER_M,
        np.array([360.0 * e.share if isinstance(e, RimElectrode) else 0.0 for e in electrodes]),
        np.array([_width_mm(electrode) for electrode in electrodes]),
        np.array([electrode.impedivity_ohm_m2 for electrode in electrodes]),
        outline=rim,
        electrode_inside_mm=np.array([_place(electrode) for electrode in electrodes]),
    )


def _width_mm(electrode: RimElectrode | InnerElectrode) -> float:
    if isinstance(electrode, RimElectrode):
        return electrode.width_mm
    return 2.0 * electrode.radius_mm


def _place(electrode: RimElectrode | InnerElectrode) -> complex:
    """The place of an electrode inside, mm; NaN of one on the rim."""
    if isinstance(electrode, RimElectrode):
        return complex(np.nan)
    return complex(electrode.x_mm, electrode.y_mm)


def rows(name: str) -> list[dict]:
    """One row for each named accuracy: RMS error untouched over the median |v|, the largest
    relative error of a touch's change on the skin and of one cut by the rim, the witness' own
    error, processor seconds and a touch that is refused; or what refuses the outline."""
    stated, channels = case(name), adjacent_channels()
    try:
        skin = geometry(stated)
        begun = time.process_time()
        solved = {accuracy: Forward(skin, accuracy) for accuracy in ACCURACIES}
        seconds = time.process_time() - begun
    except InputError as error:
        return [{"outline": name, "refused": f"{error.place}: {error.actual}"}]
    witness = stated.skin()
    untouched, changes = witness.changes(channels, list(stated.touches))
    witness_untouched, witness_touched = witness.numerical_error(channels, list(stated.touches))
    table = []
    for accuracy, forward in solved.items():
        difference = forward.voltages(channels) - untouched
        touched, refused = np.full(len(changes), np.nan), None
        for number, (touch, true) in enumerate(zip(stated.touches, changes, strict=True)):
            try:
                modes = forward.place(touch.x_mm, touch.y_mm, touch.radius_mm)
            except InputError as error:
                refused = f"a touch: {error.actual}"
                continue
            change = modes.channel_change(channels, [touch.contrast])[0]
            touched[number] = np.linalg.norm(change - true) / np.linalg.norm(true)
        table.append(
            {
                "outline": name,
                "accuracy": accuracy,
                "rms_error_of_median_v": np.sqrt(np.mean(difference**2))
                / np.median(np.abs(untouched)),
                "touch_error": np.nanmax(touched[:2]),
                "cut_touch_error": np.nanmax(touched[2:]),
                "witness_error": witness_untouched,
                "witness_touch_error": np.max(witness_touched),
                "seconds": seconds,
                "refused": refused,
            }
        )
    return table


def main() -> None:
    """Print the table; write it to benchmarks/outlines.csv."""
    names = sys.argv[1:] or ROWS
    computed = {name: pd.DataFrame(rows(name)) for name in patient(names, "outlines")}
    if set(names) < set(ROWS):
        earlier = dict(iter(pd.read_csv(CSV).groupby("outline")))
        computed = {**earlier, **computed}
    table = pd.concat([computed[name] for name in ROWS if name in computed], ignore_index=True)
    with atomic_path(CSV) as temporary:
        table.to_csv(temporary, index=False, float_format="%.3g")
    print(table.to_string(index=False, float_format=lambda v: f"{v:.2g}"))
    print(f"written to {CSV}")


if __name__ == "__main__":
    main()
