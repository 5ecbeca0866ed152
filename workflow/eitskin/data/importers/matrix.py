"""A plain matrix, frames x channels, with a description NAME.yaml beside it.

CSV with commas, semicolons, tabs or spaces, NumPy `.npy` and `.npz`. The keys of the description:
`electrodes` (how many), `drive` and `measurement` (adjacent, opposite, skip-<n>; of a measurement
also with -reversed, or ground; or as `measurement` the channels themselves, [source, sink, plus,
minus] a column), `order` (as `check` names them); `voltage` (without it signed where a reading is
negative, else magnitude), `unit`, `values`, `position_frame`, `frame_s`,
`clock` and `skin` as in the recording format; `rate_Hz`, frames a second; `source`; `labels`, the
columns touch, x_mm, y_mm, force_N, probe_mm, depth_mm, contact, session, temperature_C, time_s and
note_... (anything else, carried and ignored): a file beside it with those names, or which column of
the matrix each is. Columns of the matrix, and arrays of an `.npz`, that have such names need no
mention. Frames that nothing is said of are taken for untouched.

`drive` and `measure` may come from the caller where the description does not have them. Without
either, the columns' names may tell the channels, or the readings the pattern (`protocol_search`),
and no description is needed.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from eitskin.data import subset
from eitskin.data.importers import (
    bare_vectors,
    delimited,
    matrix_table,
    named_columns,
    protocol_search,
)
from eitskin.data.importers.bare_vectors import GROUND, Layout
from eitskin.data.importers.description import describe
from eitskin.data.importers.matrix_description import (
    DESCRIBING_KEYS,
    PLACED,
    description_path,
    in_recordings_unit,
    labels_path,
    missing_description,
    missing_labels,
    read_description,
    read_mapping,
)
from eitskin.data.importers.matrix_table import Table, is_numpy
from eitskin.data.importers.protocol_search import common_protocol
from eitskin.data.importers.workbook import is_workbook
from eitskin.data.recording import NOTE, Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles

LEFT_OPEN = ("order", "drive", "measure", "array")
TRUE, FALSE = ("1", "1.0", "true", "yes"), ("0", "0.0", "false", "no")
BLANK = "{} touched frames, whose place the labels leave blank, left out"
TABLE_SUFFIXES = (".csv", ".tsv")
MIN_COLUMNS = 8  # of a matrix without a description: narrower tables are something else


def matches(path: Path) -> bool:
    """Whether a description of a matrix stands beside the file."""
    if not path.is_file() or path == description_path(path) or not description_path(path).is_file():
        return False
    try:
        description = read_mapping(path)
    except InputError:
        return True  # whose file alone is wrong, which `load` says
    return bool({*DESCRIBING_KEYS} & description.keys())


def accepts(path: Path) -> bool:
    """Whether a file without a description is one of NumPy's, which `load` reads or refuses, or
    holds a matrix that says its channels itself.

    Raises InputError, with a proposal, for one that does not, and for a broken table.
    """
    if not path.is_file():
        return False
    if is_numpy(path):
        return True
    try:
        table = _unwrapped(matrix_table.read(path, {}), None)
    except InputError:
        suffix = path.suffix.lower()
        is_text_table = suffix == ".txt" and delimited.begins_with_row(path, MIN_COLUMNS)
        if is_workbook(path) or suffix in TABLE_SUFFIXES or is_text_table:
            raise
        return False
    rows, width = table.readings.shape
    if table.channels is not None or protocol_search.protocol_of(table.readings) is not None:
        return True
    if width >= MIN_COLUMNS or common_protocol(rows) is not None:
        raise missing_description(path, (rows, width), table.names)
    named_columns.refuse_unnamed_rows(path, table.names, table.readings)
    return False


def files(path: Path) -> list[Path]:
    """The matrix, its description and its labels."""
    try:
        labels = read_mapping(path).get("labels")
    except (InputError, OSError):
        labels = None
    label_file = labels_path(path, labels) if isinstance(labels, str) else None
    others = (description_path(path), label_file)
    return [path, *(file for file in others if file is not None and file.is_file())]


def load(
    path: Path,
    order: str | None = None,
    drive: str | None = None,
    measure: str | None = None,
    array: str | None = None,
) -> Recording:
    """One frame a row; raises InputError for a missing description, an unknown key, and a matrix
    that contradicts its description."""
    caller_settings = {"order": order, "drive": drive, "measurement": measure}
    caller_settings = {key: value for key, value in caller_settings.items() if value is not None}
    description = read_description(path) if description_path(path).is_file() else {}
    for key in (key for key in caller_settings if key in description and key != "order"):
        conflict, expected = (
            f"{description[key]!r}, and {caller_settings[key]!r} given beside it",
            "one of both",
        )
        raise InputError(
            description_path(path), f"key {key}", conflict, f"{expected}: change it here"
        )
    description = description | caller_settings
    table = _unwrapped(matrix_table.read(path, description, array), description.get("electrodes"))
    n_frames, width = table.readings.shape
    if "unit" not in description:
        description = description | in_recordings_unit(table.unit)
    if table.channels is not None and not {"drive", "measurement"} & description.keys():
        description = description | {"measurement": table.channels}
    elif "measurement" not in description:
        protocol = protocol_search.protocol_of(table.readings, description.get("electrodes"))
        if protocol is None or "drive" in description:
            raise missing_description(path, (n_frames, width), table.names)
        description = protocol.description | description
        table.remark = bare_vectors.join_remarks(
            table.remark,
            f"by the readings {protocol.layout.n_electrodes} electrodes, {protocol.drive} drive, "
            f"measurement {protocol.measurement}, order {protocol.order or 'of the drives'}",
        )
    if not n_frames or not width:
        raise InputError(path, "matrix", f"{n_frames} frames of {width} numbers", "some of each")
    try:
        layout = _layout(path, description, width)
    except InputError as error:
        raise missing_labels(path, table.names) or _turned(
            path, description, table, error
        ) from None
    if _against_ground(description, table, layout):
        layout = bare_vectors.pattern_layout(path, width, description["drive"], GROUND)
        stated = f"measurement {description['measurement']} was stated, but these are"
        table.remark = bare_vectors.join_remarks(
            table.remark, f"{stated} potentials against ground: measurement: ground"
        )
        description = description | {"measurement": GROUND}
    if {"order", "drive"} & description.keys() == {"drive"} and layout.subtrahends is None:
        bare_vectors.refuse_other_order(
            path, table.readings, description["drive"], description["measurement"], layout
        )
    return _recording(path, description, table, layout)


def _unwrapped(table: Table, n_electrodes: int | None) -> Table:
    """The table with each frame in one row where it had a row a drive; else as it is."""
    rows, width = table.readings.shape
    if table.labels or table.channels is not None:
        return table
    for n in protocol_search.RINGS if n_electrodes is None else (n_electrodes,):
        if rows % n or not n - 4 <= width <= n:
            continue
        frames = table.readings.reshape(-1, n * width)
        if protocol_search.protocol_of(frames, n) is not None:
            remark = f"{n} lines of {width} numbers make a frame of {n * width}"
            return replace(table, readings=frames, names=[], remark=remark)
    return table


def _against_ground(description: dict, table: Table, layout: Layout) -> bool:
    """Whether frames of n n numbers, stated as pairs, are potentials against ground."""
    n = layout.n_electrodes
    if layout.width != n * n or description["measurement"] == GROUND or "drive" not in description:
        return False
    protocol = protocol_search.protocol_of(table.readings, n)
    stated_drive = description["drive"]
    return (
        protocol is not None and protocol.measurement == GROUND and protocol.drive == stated_drive
    )


def _turned(path: Path, description: dict, table: Table, error: InputError) -> InputError:
    """The error of a width that fits no layout; where the rows' number does, with that said."""
    try:
        _layout(path, description, len(table.readings))
    except InputError:
        return error
    expected = f"{error.expected}; perhaps turned: its {len(table.readings)} rows would fit"
    return InputError(path, error.place, error.actual, expected)


def _layout(path: Path, description: dict, width: int) -> Layout:
    measurement, order, n = (
        description["measurement"],
        description.get("order"),
        description.get("electrodes"),
    )
    if isinstance(measurement, list):
        if "drive" in description:
            conflict = f"{description['drive']!r} beside a list of channels"
            raise InputError(
                description_path(path), "key drive", conflict, "none: each channel has its own"
            )
        return bare_vectors.channel_layout(path, width, measurement, order, n)
    if not isinstance(measurement, str):
        expected = "adjacent, opposite, skip-<n>, or a list of channels"
        raise InputError(description_path(path), "key measurement", repr(measurement), expected)
    if "drive" not in description:
        raise InputError(
            description_path(path), "key drive", "nothing", "adjacent, opposite or skip-<n>"
        )
    return bare_vectors.pattern_layout(path, width, description["drive"], measurement, order, n)


def _recording(path: Path, description: dict, table: Table, layout: Layout) -> Recording:
    labels, n_frames = table.labels, len(table.readings)
    for name, values in labels.items():
        if len(values) != n_frames:
            raise InputError(path, f"label {name}", f"{len(values)} rows", f"{n_frames}, as frames")
    touch = _touch(path, labels, n_frames)
    frames = frames_table(
        _time(path, description, labels, n_frames),
        touch,
        **{name: labels.get(name) for name in PLACED},
    )
    if "contact" in labels:
        contact = pd.Series(_integers(path, "contact", labels["contact"]), dtype="Float64")
        frames["contact"] = contact.where(touch & contact.notna()).astype("Int64")
    if "session" in labels:
        names = [None if session is None else str(session) for session in labels["session"]]
        frames["session"] = pd.Series(names, dtype=object)
    if "temperature_C" in labels:
        frames["temperature_C"] = labels["temperature_C"]
    for name in (name for name in labels if name.startswith(NOTE)):
        frames[name] = labels[name]
    readings = layout.readings(table.readings)
    if "unit_size" in description:
        readings = description["unit_size"] * readings
    has_labels = "touch" in labels or {"x_mm", "y_mm"} <= labels.keys()
    untouched_remark = "" if has_labels else bare_vectors.UNTOUCHED
    kind = description.get("voltage", bare_vectors.voltage_kind(readings))
    voltage_remark = "no reading is negative: taken for magnitudes, as `voltage` is not stated"
    voltage_remark = voltage_remark if kind == "magnitude" and "voltage" not in description else ""
    is_placed = ~touch | frames[["x_mm", "y_mm"]].notna().any(axis=1).to_numpy()
    is_placed |= not is_placed[touch].any()
    blank_remark = "" if is_placed.all() else BLANK.format((~is_placed).sum())
    parts = bare_vectors.join_remarks(
        f"matrix {path.name}",
        table.remark,
        layout.left_out,
        untouched_remark,
        voltage_remark,
        blank_remark,
    )
    skin = description.get("skin", {})
    angles = skin.get("electrode_deg", even_angles(layout.n_electrodes).tolist())
    if isinstance(angles, list) and len(angles) < layout.n_electrodes:
        violation = f"{len(angles)} angles"
        expected = f"{layout.n_electrodes}, one an electrode"
        raise InputError(description_path(path), "skin.electrode_deg", violation, expected)
    is_timed = "rate_Hz" in description or "time_s" in labels
    metadata = describe(
        layout.channels,
        [],
        f"{description['source']} ({parts})" if "source" in description else parts,
        kind,
        position_frame=description.get("position_frame", "skin"),
        values=description.get("values", "absolute"),
        unit=description.get("unit", "arbitrary"),
        clock=description.get("clock", "measured" if is_timed else "index"),
        skin=skin | {"electrode_deg": angles},
    )
    metadata["frame_s"] = description.get("frame_s")
    quadrature = readings.imag.astype(float) if np.iscomplexobj(readings) else None
    recorded = Recording(frames, readings.real.astype(float), quadrature, None, metadata)
    return recorded if is_placed.all() else subset.numbered(subset.of_frames(recorded, is_placed))


def _time(path: Path, description: dict, labels: dict, n_frames: int) -> np.ndarray:
    """Seconds (F,) from the first frame; raises InputError where times are missing or do not
    increase."""
    if "rate_Hz" in description and "time_s" in labels:
        raise InputError(description_path(path), "key rate_Hz", "it beside time_s", "one of both")
    if "time_s" in labels:
        time = np.asarray(labels["time_s"], dtype=float)
        bad_rows = np.flatnonzero(~(np.diff(time) > 0))
        if len(bad_rows) or np.isnan(time).any():
            row = int(bad_rows[0]) + 1 if len(bad_rows) else 0
            expected = f"more than {time[row - 1]}: time goes on" if row else "a number"
            raise InputError(path, f"time_s, row {row}", time[row], expected)
        return time - time[0]
    if "rate_Hz" in description:
        return np.arange(n_frames) / description["rate_Hz"]
    if description.get("clock") == "measured":
        raise InputError(
            description_path(path), "key clock", "measured", "rate_Hz, or a label time_s"
        )
    return np.arange(n_frames, dtype=float)


def _touch(path: Path, labels: dict, n_frames: int) -> np.ndarray:
    """(F,) bool: the label `touch`, or without it where a place is known."""
    if "touch" not in labels:
        places = [np.asarray(labels.get(name, np.full(n_frames, np.nan))) for name in PLACED[:2]]
        return np.isfinite(np.array(places)).all(axis=0)
    cells = [str(label).lower() for label in labels["touch"]]
    for row, cell in enumerate(cells):
        if cell not in (*TRUE, *FALSE):
            expected = "1 or 0, true or false, yes or no"
            raise InputError(path, f"label touch, row {row}", repr(cell), expected)
    return np.array([cell in TRUE for cell in cells])


def _integers(path: Path, name: str, values: np.ndarray) -> np.ndarray:
    values = np.asarray(values, dtype=float)
    bad_rows = np.flatnonzero(np.isfinite(values) & (values != np.round(values)))
    if len(bad_rows):
        place = f"label {name}, row {bad_rows[0]}"
        raise InputError(path, place, values[bad_rows[0]], "a whole number")
    return values
