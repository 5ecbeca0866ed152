"""EIT recordings: one Parquet file each, the same for a rig, a simulator or somebody's archive."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from eitskin.atomic import atomic_path
from eitskin.data import parquet
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.physics.skin import Skin, is_number

SCHEMA_KEY = b"eit"
COLUMNS = {
    "frame": pa.int64(),
    "time_s": pa.float64(),
    "touch": pa.bool_(),
    "x_mm": pa.float64(),
    "y_mm": pa.float64(),
    "force_N": pa.float64(),
    "probe_mm": pa.float64(),
    "depth_mm": pa.float64(),
}
OPTIONAL_COLUMNS = {
    "session": pa.string(),
    "contact": pa.int64(),
    "temperature_C": pa.float64(),
}
READINGS = ("voltage_V", "quadrature_V")
TOUCH_KEYS = ("x_mm", "y_mm", "force_N", "probe_mm")
TOUCHES = pa.list_(pa.struct([(key, pa.float64()) for key in TOUCH_KEYS]))
NOTE = "note_"
REQUIRED_KEYS = (
    "format",
    "version",
    "channels",
    "voltage",
    "frame_s",
    "position_frame",
    "source",
    "skin",
)
DEFAULTS = {
    "values": "absolute",
    "unit": "V",
    "clock": "measured",
    "source_reference": "floating",
}
CHOICES = {
    "format": ("eit-recording",),
    "voltage": ("signed", "magnitude"),
    "values": ("absolute", "difference"),
    "unit": ("V", "ohm", "arbitrary"),
    "clock": ("measured", "index"),
    "position_frame": ("skin", "robot"),
    "source_reference": ("floating", "sink-grounded"),
}
ABSOLUTE_ZERO_C = -273.15
ONE_PLACE_MM = 1.0  # positions this near are one place
ONE_PRESS_MM = 10.0  # as far as a robot that is told of one press may be off
MOST_ELECTRODES = 1024
CLOCK_ROUNDING = 1e-6


@dataclass
class Recording:
    """N frames of M channels in order of capture, with what their owner believes of the skin.

    `frames` holds the scalar columns (units in their names; NaN where null) and any `note_`
    columns; `voltage` (N, M) is None for a query; `quadrature` (N, M) and `touches` (a list a frame
    of {x_mm, y_mm, force_N, probe_mm}, None where untouched) are None where the file has none;
    `metadata` has every key, defaults filled in.
    """

    frames: pd.DataFrame
    voltage: np.ndarray | None
    quadrature: np.ndarray | None
    touches: list | None
    metadata: dict

    @property
    def readings(self) -> np.ndarray:
        """`voltage` of a recording that is no query."""
        assert self.voltage is not None
        return self.voltage

    @property
    def channels(self) -> np.ndarray:
        """(M, 4) int: source, sink, plus, minus."""
        return np.array(self.metadata["channels"], dtype=int).reshape(-1, 4)

    @property
    def skin(self) -> Skin:
        """What the owner believes of the skin."""
        return Skin.from_metadata(self.metadata["skin"])

    @property
    def n_electrodes(self) -> int:
        """Electrodes of the skin; where their angles are unknown, those that the channels name."""
        angles = self.metadata["skin"]["electrode_deg"]
        return len(angles) if angles is not None else int(self.channels.max()) + 1


def frames_table(
    time_s: np.ndarray,
    touch: np.ndarray,
    x_mm: np.ndarray | None = None,
    y_mm: np.ndarray | None = None,
    force_N: np.ndarray | None = None,
    probe_mm: np.ndarray | float | None = None,
    depth_mm: np.ndarray | None = None,
) -> pd.DataFrame:
    """The required scalar columns of N frames.

    `time_s`, `touch` and the others are (N,) or one number for all; None: unknown. Untouched frames
    get force 0 and no place, probe or depth, whatever stands there.
    """
    touch = np.asarray(touch, dtype=bool)
    table = {
        "frame": np.arange(len(touch), dtype=np.int64),
        "time_s": np.asarray(time_s, dtype=float),
        "touch": touch,
    }
    given = {
        "x_mm": x_mm,
        "y_mm": y_mm,
        "force_N": force_N,
        "probe_mm": probe_mm,
        "depth_mm": depth_mm,
    }
    for name, values in given.items():
        values = np.nan if values is None else np.asarray(values, dtype=float)
        table[name] = np.where(touch, values, 0.0 if name == "force_N" else np.nan)
    return pd.DataFrame(table)


def voltages(recording: Recording, name: str | Path) -> np.ndarray:
    """(N, M): a recording's `voltage`. Raises InputError, with `name` as its place, for a query."""
    if recording.voltage is None:
        raise InputError(name, "column voltage_V", "nothing", "voltages; this is a query")
    return recording.voltage


def presses(recording: Recording) -> np.ndarray:
    """(N,) int: the press that each touched frame belongs to, 0, 1, 2, ... ; -1 where untouched.

    The `contact` column (within a session) where there is one; else a run of touched frames at one
    place.
    """
    frames = recording.frames
    touch = frames["touch"].to_numpy(dtype=bool)
    label = np.full(len(touch), -1)
    session = frames["session"] if "session" in frames else pd.Series([""] * len(touch))
    if "contact" in frames:
        keys = list(zip(session[touch], frames["contact"][touch], strict=True))
        label[touch] = pd.factorize(pd.Series(keys, dtype=object))[0]
        return label
    place = frames[["x_mm", "y_mm"]].to_numpy()
    starts = touch.copy()
    starts[1:] &= ~touch[:-1] | (place[1:] != place[:-1]).any(axis=1) | _changes(session)[1:]
    label[touch] = np.cumsum(starts)[touch] - 1
    return label


def elapsed(frames: pd.DataFrame) -> np.ndarray:
    """(N,): how much of the time of frames has gone, 0 to 1; by their number where none goes."""
    time = frames["time_s"].to_numpy(float)
    if not np.ptp(time):
        time = np.arange(len(time), dtype=float)
    return (time - time[0]) / (float(np.ptp(time)) or 1.0)


def _changes(session: pd.Series) -> np.ndarray:
    names = session.to_numpy(dtype=object)
    return np.array([True, *(a != b for a, b in zip(names[1:], names[:-1], strict=True))])


def read(path: str | Path) -> Recording:
    """Read and validate a recording or a query.

    Raises InputError naming file, column or key, row, what was found and what was expected.
    """
    table = parquet.read(path)
    metadata = _read_metadata(path, table.schema.metadata or {})
    names = table.column_names
    for name in names:
        if names.count(name) > 1:
            raise InputError(path, f"column {name}", f"{names.count(name)} of them", "one")
    width = len(metadata["channels"])
    _check_columns(path, table.schema, width)
    plain = [name for name in names if name in COLUMNS or name in OPTIONAL_COLUMNS]
    frames = pd.DataFrame(
        {name: _scalar_column(path, name, table[name]) for name in plain},
        index=pd.RangeIndex(table.num_rows),
    )
    notes = table.select([name for name in names if name.startswith(NOTE)])
    options = {"types_mapper": pd.ArrowDtype, "ignore_metadata": True}
    frames = frames.join(parquet.frame(notes, **options))
    readings = {
        name: _reading_column(path, name, table[name], width) if name in names else None
        for name in READINGS
    }
    touches = table["touches"].to_pylist() if "touches" in names else None
    recording = Recording(
        frames, readings["voltage_V"], readings["quadrature_V"], touches, metadata
    )
    validate(recording, path)
    return recording


def write(recording: Recording, path: str | Path) -> None:
    """Validate and write a recording: whole or not at all, the same bytes for the same recording.

    Raises InputError as `read` does; then nothing is written.
    """
    validate(recording, path)
    arrays = {}
    for name in recording.frames:
        kind = COLUMNS.get(name) or OPTIONAL_COLUMNS.get(name)
        arrays[name] = pa.array(recording.frames[name], type=kind, from_pandas=True)
    for name, values in zip(READINGS, (recording.voltage, recording.quadrature), strict=True):
        if values is not None:
            arrays[name] = parquet.lists(np.asarray(values, dtype=float))
    if recording.touches is not None:
        arrays["touches"] = pa.array(recording.touches, type=TOUCHES)
    text = json.dumps(recording.metadata, sort_keys=True, allow_nan=False)
    table = pa.table(arrays).replace_schema_metadata({SCHEMA_KEY: text.encode()})
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        pq.write_table(table, stream, compression="zstd", write_page_checksum=True)


def metadata_of(
    channels: np.ndarray,
    skin: dict,
    source: str,
    voltage: str = "signed",
    position_frame: str = "skin",
    frame_s: float | None = None,
    **others: str,
) -> dict:
    """The metadata of a recording of channels (M, 4); `skin` as `Skin.metadata`; frame_s: s;
    `others`: values of keys of DEFAULTS, where they are not the default ones."""
    return {
        **DEFAULTS,
        "format": "eit-recording",
        "version": 1,
        "channels": np.asarray(channels).tolist(),
        "voltage": voltage,
        "frame_s": frame_s,
        "position_frame": position_frame,
        "source": source,
        "skin": skin,
        **others,
    }


def validate(recording: Recording, file: str | Path) -> None:
    """Raise InputError, with `file` as its place, unless the recording keeps every rule."""
    metadata = recording.metadata
    _check_metadata(file, metadata)
    frames = recording.frames
    if len(frames) == 0:
        raise InputError(file, "rows", "none", "one a frame")
    _check_frames(file, frames)
    _check_clock(file, recording)
    _check_contacts(file, frames)
    shape = (len(frames), len(metadata["channels"]))
    pairs = zip(READINGS, (recording.voltage, recording.quadrature), strict=True)
    for name, values in pairs:
        if values is None:
            continue
        if values.shape != shape:
            raise InputError(file, f"column {name}", values.shape, f"{shape}: frames x channels")
        _refuse_rows(file, name, values, np.isinf(values), "finite, or NaN if lost")
    if recording.touches is not None:
        _check_touches(file, recording)
    _check_on_skin(file, recording)
    if recording.voltage is None:
        if recording.quadrature is not None:
            raise InputError(file, "column voltage_V", "nothing", "it beside quadrature_V")
        return
    if np.isnan(recording.voltage).all():
        raise InputError(file, "column voltage_V", "every channel lost", "some reading")
    if metadata["values"] == "absolute":
        if metadata["voltage"] == "magnitude":
            negative = recording.voltage < 0
            _refuse_rows(file, "voltage_V", recording.voltage, negative, "magnitudes, 0 or more")
        if frames["touch"].all():
            expected = "at least one untouched frame among absolute values"
            raise InputError(file, "column touch", f"true in all {len(frames)} rows", expected)


def _read_metadata(path: str | Path, schema_metadata: dict) -> dict:
    if SCHEMA_KEY not in schema_metadata:
        raise InputError(path, "schema key eit", "nothing", "the recording's metadata as JSON")
    try:
        metadata = json.loads(schema_metadata[SCHEMA_KEY])
    except (ValueError, RecursionError) as error:
        raise InputError(path, "schema key eit", f"no JSON ({error})", "JSON") from error
    if not isinstance(metadata, dict):
        raise InputError(path, "schema key eit", type(metadata).__name__, "a JSON object")
    metadata = DEFAULTS | metadata
    _check_metadata(path, metadata)
    return metadata


def _check_metadata(file: str | Path, metadata: dict) -> None:
    for key in (*REQUIRED_KEYS, *DEFAULTS):
        if key not in metadata:
            raise InputError(file, f"key {key}", "nothing", f"it among {list(REQUIRED_KEYS)}")
    for key in metadata:
        if key not in REQUIRED_KEYS and key not in DEFAULTS:
            known = [*REQUIRED_KEYS, *DEFAULTS]
            raise InputError(file, f"key {key}", "an unknown key", f"one of {known}")
    check_reading(metadata, file)
    if type(metadata["version"]) is not int or metadata["version"] != 1:
        raise InputError(file, "key version", json.dumps(metadata["version"]), "1")
    if not isinstance(metadata["source"], str) or not metadata["source"]:
        expected = "where the recording comes from"
        raise InputError(file, "key source", json.dumps(metadata["source"]), expected)
    skin = Skin.from_metadata(metadata["skin"], str(file))
    n = None if skin.electrode_deg is None else len(skin.electrode_deg)
    _check_channels(file, metadata["channels"], n)
    _check_arcs(file, skin)


def check_reading(metadata: dict, file: str | Path) -> None:
    """Raise InputError, with `file` as its place, for a value of `frame_s` or of a key of CHOICES,
    as far as they are there, that the format does not know."""
    for key, choices in CHOICES.items():
        if key in metadata and metadata[key] not in choices:
            expected = " or ".join(f'"{choice}"' for choice in choices)
            raise InputError(file, f"key {key}", json.dumps(metadata[key], default=str), expected)
    frame_s = metadata.get("frame_s")
    if frame_s is not None and not (is_number(frame_s) and frame_s > 0):
        found = json.dumps(frame_s, default=str)
        raise InputError(file, "key frame_s", found, "more than 0 s, or null")


def _check_arcs(file: str | Path, skin: Skin) -> None:
    """Refuse electrodes that overlap; for that, material and contacts do not matter."""
    radius, angles, width = skin.radius_mm, skin.electrode_deg, skin.electrode_width_mm
    if radius is None or angles is None or width is None:
        return
    try:
        Geometry(radius, 1.0, 1.0, np.array(angles), np.array(width), np.array(1.0))
    except InputError as error:
        found = f"{width} mm: {error.actual}"
        raise InputError(file, "skin.electrode_width_mm", found, error.expected) from error


def _check_channels(file: str | Path, channels: object, n_electrodes: int | None) -> None:
    if not isinstance(channels, list) or not channels:
        raise InputError(file, "key channels", json.dumps(channels), "a list of channels")
    expected = "[source, sink, plus, minus], whole numbers"
    for row, channel in enumerate(channels):
        place = f"key channels, row {row}"
        whole = isinstance(channel, list) and all(type(electrode) is int for electrode in channel)
        if not whole or len(channel) != 4:
            raise InputError(file, place, json.dumps(channel), expected)
        for electrode in channel:
            most = n_electrodes or MOST_ELECTRODES
            if not 0 <= electrode < most:
                found = f"electrode {electrode} of {n_electrodes or 'an unknown number'}"
                raise InputError(file, place, found, f"electrodes 0 to {most - 1}")
        source, sink, plus, minus = channel
        if source == sink or plus == minus:
            raise InputError(file, place, f"{channel}, a pair with itself", "two electrodes a pair")


def _check_columns(file: str | Path, schema: pa.Schema, width: int) -> None:
    for name in COLUMNS:
        if name not in schema.names:
            raise InputError(file, f"column {name}", "nothing", f"it among {list(COLUMNS)}")
    reading = pa.list_(pa.float64(), width)
    types = COLUMNS | OPTIONAL_COLUMNS | dict.fromkeys(READINGS, reading) | {"touches": TOUCHES}
    for field in schema:
        if field.name.startswith(NOTE):
            continue
        if field.name not in types:
            expected = f"one of {list(types)} or {NOTE}..."
            raise InputError(file, f"column {field.name}", "an unknown column", expected)
        if not _same_type(field.type, types[field.name]):
            expected = str(types[field.name])
            if field.name in READINGS:
                expected = f"fixed_size_list<double>[{width}], one a channel"
            raise InputError(file, f"column {field.name}", str(field.type), expected)


def _same_type(found: pa.DataType, expected: pa.DataType) -> bool:
    if pa.types.is_fixed_size_list(expected):
        return (
            pa.types.is_fixed_size_list(found)
            and found.list_size == expected.list_size
            and found.value_type == expected.value_type
        )
    if pa.types.is_list(expected):
        if not pa.types.is_list(found) or not pa.types.is_struct(found.value_type):
            return False
        fields = sorted((field.name, str(field.type)) for field in found.value_type)
        return fields == sorted((field.name, str(field.type)) for field in expected.value_type)
    return found == expected or (expected == pa.string() and found == pa.large_string())


def _scalar_column(file: str | Path, name: str, column: pa.ChunkedArray) -> np.ndarray | pd.Series:
    if name in ("frame", "touch", "time_s") and column.null_count:
        row = column.is_null().to_pylist().index(True)
        raise InputError(file, f"column {name}, row {row}", "null", str(COLUMNS[name]))
    if name == "session":
        return pd.Series(column.to_pylist(), dtype=object)
    if name == "contact":
        return pd.Series(column.to_pylist(), dtype="Int64")
    return column.to_numpy()


def _reading_column(file: str | Path, name: str, column: pa.ChunkedArray, width: int) -> np.ndarray:
    nulls = column.is_null().to_numpy()
    if not nulls.any():
        values = column.combine_chunks().flatten()
        if not values.null_count:
            return values.to_numpy(zero_copy_only=False).reshape(-1, width)
        nulls = values.is_null().to_numpy(zero_copy_only=False).reshape(-1, width).any(axis=1)
    row = int(np.flatnonzero(nulls)[0])
    raise InputError(file, f"column {name}, row {row}", "null", "a number, or NaN if lost")


def _refuse_rows(
    file: str | Path, name: str, values: np.ndarray, bad: np.ndarray, expected: str
) -> None:
    """Refuse the first bad value of a column (N,) or of readings (N, M)."""
    wrong = np.argwhere(bad)
    if len(wrong):
        row, *channel = wrong[0].tolist()
        found = values[tuple(wrong[0])]
        where = f" in channel {channel[0]}" if channel else ""
        raise InputError(file, f"column {name}, row {row}", f"{found}{where}", expected)


def _check_frames(file: str | Path, frames: pd.DataFrame) -> None:
    for name in COLUMNS:
        if name not in frames:
            raise InputError(file, f"column {name}", "nothing", f"it among {list(COLUMNS)}")
    for name in frames:
        if name not in COLUMNS and name not in OPTIONAL_COLUMNS and not name.startswith(NOTE):
            raise InputError(file, f"column {name}", "an unknown column", f"or {NOTE}...")

    def refuse(name: str, bad: np.ndarray, expected: str) -> None:
        _refuse_rows(file, name, frames[name].to_numpy(), bad, expected)

    frame = frames["frame"].to_numpy()
    refuse("frame", frame != np.arange(len(frame)), "0, 1, 2, ... in order")
    time = frames["time_s"].to_numpy(dtype=float)
    refuse("time_s", ~np.isfinite(time) | (time < 0), "seconds from the recording's start")
    backwards = np.flatnonzero(np.diff(time) <= 0)
    if len(backwards):
        row = int(backwards[0]) + 1
        expected = f"more than {time[row - 1]}: time strictly increasing"
        raise InputError(file, f"column time_s, row {row}", time[row], expected)
    touch = frames["touch"].to_numpy(dtype=bool)
    for name in ("x_mm", "y_mm"):
        place = frames[name].to_numpy(dtype=float)
        refuse(name, touch & ~np.isfinite(place), "the contact's centre where touch is true")
        refuse(name, ~touch & ~np.isnan(place), "null where touch is false")
    force = frames["force_N"].to_numpy(dtype=float)
    refuse("force_N", ~touch & ~(np.isnan(force) | (force == 0)), "0 where touch is false")
    refuse("force_N", (force < 0) | np.isinf(force), "0 N or more, or null")
    probe = frames["probe_mm"].to_numpy(dtype=float)
    refuse("probe_mm", ~touch & ~np.isnan(probe), "null where touch is false")
    refuse("probe_mm", (probe <= 0) | np.isinf(probe), "more than 0 mm, or null")
    depth = frames["depth_mm"].to_numpy(dtype=float)
    refuse("depth_mm", (depth < 0) | np.isinf(depth), "0 mm or more, or null")
    if "temperature_C" in frames:
        warm = frames["temperature_C"].to_numpy(dtype=float)
        bad = (warm < ABSOLUTE_ZERO_C) | np.isinf(warm)
        refuse("temperature_C", bad, f"more than {ABSOLUTE_ZERO_C} degrees, or null")
    if "contact" in frames:
        missing = frames["contact"].isna().to_numpy()
        refuse("contact", touch & missing, "the press where touch is true")


def _check_clock(file: str | Path, recording: Recording) -> None:
    """Refuse frames that last longer than the time to the next, by a measured clock."""
    frame_s, time = recording.metadata["frame_s"], recording.frames["time_s"].to_numpy(dtype=float)
    if frame_s is None or recording.metadata["clock"] != "measured" or len(time) < 2:
        return
    row = int(np.argmin(np.diff(time)))
    least = time[row + 1] - time[row]
    if frame_s > least * (1.0 + CLOCK_ROUNDING):
        expected = f"at most {least:.6g} s, the time from row {row} to row {row + 1}"
        raise InputError(file, "key frame_s", frame_s, expected)


def _check_contacts(file: str | Path, frames: pd.DataFrame) -> None:
    """Refuse one press, by its session and `contact`, at places that are no one's scatter."""
    if "contact" not in frames:
        return
    touched = frames[frames["touch"].to_numpy(dtype=bool)]
    by = ["session", "contact"] if "session" in frames else ["contact"]
    places = touched.groupby(by, sort=False, dropna=False)[["x_mm", "y_mm"]]
    away = (touched[["x_mm", "y_mm"]] - places.transform("first")).to_numpy(dtype=float)
    wrong = np.flatnonzero(np.hypot(*away.T) > ONE_PRESS_MM)
    if len(wrong):
        row = int(touched.index[wrong[0]])
        found = f"{touched['contact'][row]} again, {np.hypot(*away[wrong[0]]):.3g} mm away"
        expected = f"one number a press, within {ONE_PRESS_MM:g} mm"
        raise InputError(file, f"column contact, row {row}", found, expected)


def _check_on_skin(file: str | Path, recording: Recording) -> None:
    """Refuse touches that cannot meet the skin, where its size and frame are known.

    An unknown probe is taken for one as large as the skin.
    """
    radius = recording.skin.radius_mm
    if radius is None or recording.metadata["position_frame"] != "skin":
        return
    if recording.touches is None:
        at = recording.frames[list(TOUCH_KEYS)].assign(row=recording.frames["frame"])
    else:
        numbered = enumerate(recording.touches)
        all_touches = [{**touch, "row": row} for row, some in numbered for touch in some or []]
        at = pd.DataFrame(all_touches, columns=[*TOUCH_KEYS, "row"])
    reach = radius + 0.5 * at["probe_mm"].astype(float).fillna(2.0 * radius).to_numpy()
    distance = np.hypot(at["x_mm"].to_numpy(float), at["y_mm"].to_numpy(float))
    wrong = np.flatnonzero(distance > reach)
    if len(wrong):
        place = f"columns x_mm, y_mm, row {int(at['row'].iloc[wrong[0]])}"
        found = f"a touch {distance[wrong[0]]:.6g} mm from the centre"
        expected = f"at most {reach[wrong[0]]:.6g} mm: probe and skin, radius {radius:g}, must meet"
        raise InputError(file, place, found, expected)


def _check_touches(file: str | Path, recording: Recording) -> None:
    frames = recording.frames
    assert recording.touches is not None
    if len(recording.touches) != len(frames):
        found = f"{len(recording.touches)} rows"
        raise InputError(file, "column touches", found, f"{len(frames)}, one a frame")
    touched = frames["touch"].to_numpy(dtype=bool)
    plain = frames[list(TOUCH_KEYS)].to_numpy(dtype=float)
    for row, touches in enumerate(recording.touches):
        place = f"column touches, row {row}"
        if not touched[row]:
            if touches:
                raise InputError(file, place, f"{len(touches)} touches", "none: touch is false")
            continue
        if not touches:
            raise InputError(file, place, "none", "all touches: touch is true")
        for touch in touches:
            _check_touch(file, place, touch)
        first = np.array([_number(touches[0][key]) for key in TOUCH_KEYS])
        if not np.array_equal(first, plain[row], equal_nan=True):
            raise InputError(file, place, touches[0], "first the touch of the plain columns")


def _check_touch(file: str | Path, place: str, touch: dict | None) -> None:
    if not isinstance(touch, dict) or set(touch) != set(TOUCH_KEYS):
        raise InputError(file, place, touch, f"{{{', '.join(TOUCH_KEYS)}}}")
    x, y, force, probe = (_number(touch[key]) for key in TOUCH_KEYS)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(file, place, touch, "a place, x_mm and y_mm")
    if force < 0 or math.isinf(force):
        raise InputError(file, place, touch, "force_N 0 or more, or null")
    if probe <= 0 or math.isinf(probe):
        raise InputError(file, place, touch, "probe_mm more than 0, or null")


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
