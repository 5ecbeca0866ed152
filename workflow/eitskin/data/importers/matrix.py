"""A plain matrix, frames x channels, with a description NAME.yaml beside it.

CSV with commas, semicolons, tabs or spaces, NumPy `.npy` and `.npz`. The keys of the description:
`electrodes` (how many), `drive` and `measurement` (adjacent, opposite, skip-<n>; of a measurement
also with -reversed; or as `measurement` the channels themselves, [source, sink, plus, minus] a
column), `order` (as `check` names them); `voltage` (without it signed where a reading is negative,
else magnitude), `unit`, `values`, `position_frame`, `frame_s`,
`clock` and `skin` as in the recording format; `rate_Hz`, frames a second; `source`; `labels`, the
columns touch, x_mm, y_mm, force_N, probe_mm, depth_mm, contact, session, temperature_C, time_s and
note_... (anything else, carried and ignored): a file beside it with those names, or which column of
the matrix each is. Columns of the matrix, and arrays of an `.npz`, that have such names need no
mention. Frames that nothing is said of are taken for untouched.

`drive` and `measure` may come from the caller where the description does not have them; with both,
none is needed.
"""

from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data.importers import bare_vectors, matrix_table
from eitskin.data.importers.bare_vectors import Layout
from eitskin.data.importers.description import describe
from eitskin.data.importers.matrix_description import (
    PLACED,
    TELLING,
    beside,
    described,
    example,
    mapping,
    undescribed,
    unlabelled,
)
from eitskin.data.importers.matrix_table import Table, is_numpy
from eitskin.data.recording import NOTE, Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles

LEFT_OPEN = ("order", "drive", "measure")
TRUE, FALSE = ("1", "1.0", "true", "yes"), ("0", "0.0", "false", "no")
NAMED_SO = (".csv", ".tsv")
LEAST_COLUMNS = 8  # of what is called a matrix without a description


def matches(path: Path) -> bool:
    """Whether a description of a matrix stands beside the file."""
    if not path.is_file() or path == beside(path) or not beside(path).is_file():
        return False
    try:
        said = mapping(path)
    except InputError:
        return True  # whose file alone is wrong, which `load` says
    return bool({*TELLING} & said.keys())


def refusal(path: Path) -> InputError | None:
    """Of a matrix without a description: which one to write beside it; of what is named as a table
    and is none, why."""
    if not path.is_file():
        return None
    try:
        table = matrix_table.read(path, {})
    except InputError as error:
        return error if is_numpy(path) or path.suffix.lower() in NAMED_SO else None
    rows, width = table.readings.shape
    wide = width >= LEAST_COLUMNS or is_numpy(path) or example(path, rows) is not None
    return undescribed(path, (rows, width), table.names) if wide else None


def files(path: Path) -> list[Path]:
    """The matrix, its description and its labels."""
    try:
        labels = mapping(path).get("labels")
    except (InputError, OSError):
        labels = None
    more = [path.parent / labels] if isinstance(labels, str) else []
    return [path, *(file for file in (beside(path), *more) if file.is_file())]


def load(
    path: Path, order: str | None = None, drive: str | None = None, measure: str | None = None
) -> Recording:
    """A frame a row; raises InputError for a missing description, an unknown key, and a matrix that
    does not fit to what is said of it."""
    given = {"order": order, "drive": drive, "measurement": measure}
    given = {key: value for key, value in given.items() if value is not None}
    said = described(path) if beside(path).is_file() else {}
    for key in (key for key in given if key in said and key != "order"):
        found, expected = f"{said[key]!r}, and {given[key]!r} given beside it", "one of both"
        raise InputError(beside(path), f"key {key}", found, f"{expected}: change it here")
    said = said | given
    table = matrix_table.read(path, said)
    n_frames, width = table.readings.shape
    if "measurement" not in said:
        raise undescribed(path, (n_frames, width), table.names)
    if not n_frames or not width:
        raise InputError(path, "matrix", f"{n_frames} frames of {width} numbers", "some of each")
    try:
        layout = _layout(path, said, width)
    except InputError as error:
        raise unlabelled(path, table.names) or error from None
    if "order" not in said and "drive" in said:
        bare_vectors.refuse_other_order(
            path, table.readings, said["drive"], said["measurement"], layout
        )
    return _recording(path, said, table, layout)


def _layout(path: Path, said: dict, width: int) -> Layout:
    measured, order, n = said["measurement"], said.get("order"), said.get("electrodes")
    if isinstance(measured, list):
        if "drive" in said:
            found = f"{said['drive']!r} beside a list of channels"
            raise InputError(beside(path), "key drive", found, "none: each channel has its own")
        return bare_vectors.listed(path, width, measured, order, n)
    if not isinstance(measured, str):
        expected = "adjacent, opposite, skip-<n>, or a list of channels"
        raise InputError(beside(path), "key measurement", repr(measured), expected)
    if "drive" not in said:
        raise InputError(beside(path), "key drive", "nothing", "adjacent, opposite or skip-<n>")
    return bare_vectors.stepped(path, width, said["drive"], measured, order, n)


def _recording(path: Path, said: dict, table: Table, layout: Layout) -> Recording:
    labels, n_frames = table.labels, len(table.readings)
    for name, values in labels.items():
        if len(values) != n_frames:
            raise InputError(path, f"label {name}", f"{len(values)} rows", f"{n_frames}, as frames")
    touch = _touch(path, labels, n_frames)
    frames = frames_table(
        _time(path, said, labels, n_frames), touch, **{name: labels.get(name) for name in PLACED}
    )
    if "contact" in labels:
        contact = pd.Series(_whole(path, "contact", labels["contact"]), dtype="Float64")
        frames["contact"] = contact.where(touch & contact.notna()).astype("Int64")
    if "session" in labels:
        names = [None if one is None else str(one) for one in labels["session"]]
        frames["session"] = pd.Series(names, dtype=object)
    if "temperature_C" in labels:
        frames["temperature_C"] = labels["temperature_C"]
    for name in (name for name in labels if name.startswith(NOTE)):
        frames[name] = labels[name]
    readings = table.readings[:, layout.columns]
    told = "touch" in labels or {"x_mm", "y_mm"} <= labels.keys()
    nobody = "" if told else bare_vectors.UNTOUCHED
    kind = said.get("voltage", bare_vectors.voltage_kind(readings))
    guessed = "no reading is negative: taken for magnitudes, as `voltage` is not stated"
    guessed = guessed if kind == "magnitude" and "voltage" not in said else ""
    parts = bare_vectors.said(f"matrix {path.name}", layout.left_out, nobody, guessed)
    skin = said.get("skin", {})
    angles = skin.get("electrode_deg", even_angles(layout.n_electrodes).tolist())
    if isinstance(angles, list) and len(angles) < layout.n_electrodes:
        found = f"{len(angles)} angles"
        expected = f"{layout.n_electrodes}, one an electrode"
        raise InputError(beside(path), "skin.electrode_deg", found, expected)
    timed = "rate_Hz" in said or "time_s" in labels
    metadata = describe(
        layout.channels,
        [],
        f"{said['source']} ({parts})" if "source" in said else parts,
        kind,
        position_frame=said.get("position_frame", "skin"),
        values=said.get("values", "absolute"),
        unit=said.get("unit", "arbitrary"),
        clock=said.get("clock", "measured" if timed else "index"),
        skin=skin | {"electrode_deg": angles},
    )
    metadata["frame_s"] = said.get("frame_s")
    quadrature = readings.imag.astype(float) if np.iscomplexobj(readings) else None
    return Recording(frames, readings.real.astype(float), quadrature, None, metadata)


def _time(path: Path, said: dict, labels: dict, n_frames: int) -> np.ndarray:
    """(F,) seconds from the first frame; raises InputError where time is missing, runs backwards or
    stands still."""
    if "rate_Hz" in said and "time_s" in labels:
        raise InputError(beside(path), "key rate_Hz", "it beside time_s", "one of both")
    if "time_s" in labels:
        time = np.asarray(labels["time_s"], dtype=float)
        wrong = np.flatnonzero(~(np.diff(time) > 0))
        if len(wrong) or np.isnan(time).any():
            row = int(wrong[0]) + 1 if len(wrong) else 0
            expected = f"more than {time[row - 1]}: time goes on" if row else "a number"
            raise InputError(path, f"time_s, row {row}", time[row], expected)
        return time - time[0]
    if "rate_Hz" in said:
        return np.arange(n_frames) / said["rate_Hz"]
    if said.get("clock") == "measured":
        raise InputError(beside(path), "key clock", "measured", "rate_Hz, or a label time_s")
    return np.arange(n_frames, dtype=float)


def _touch(path: Path, labels: dict, n_frames: int) -> np.ndarray:
    """(F,) bool: as labelled, else where a place is."""
    if "touch" not in labels:
        places = [np.asarray(labels.get(name, np.full(n_frames, np.nan))) for name in PLACED[:2]]
        return np.isfinite(np.array(places)).all(axis=0)
    cells = [str(one).lower() for one in labels["touch"]]
    for row, cell in enumerate(cells):
        if cell not in (*TRUE, *FALSE):
            expected = "1 or 0, true or false, yes or no"
            raise InputError(path, f"label touch, row {row}", repr(cell), expected)
    return np.array([cell in TRUE for cell in cells])


def _whole(path: Path, name: str, values: np.ndarray) -> np.ndarray:
    values = np.asarray(values, dtype=float)
    wrong = np.flatnonzero(np.isfinite(values) & (values != np.round(values)))
    if len(wrong):
        place = f"label {name}, row {wrong[0]}"
        raise InputError(path, place, values[wrong[0]], "a whole number")
    return values
