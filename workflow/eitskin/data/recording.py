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
from eitskin.physics.outline import inside_mm
from eitskin.physics.skin import ELECTRODE_PLACES, LARGEST, MAX_ELECTRODES, Skin, is_number
from eitskin.yaml_number import hint

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
UNTOUCHED_FORCE = f"{NOTE}untouched_force_N"  # what the load cell reads where nobody touches
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
ONE_PLACE_MM = 1.0  # positions within this are one place: a robot repeats to 0.1 mm
ONE_PRESS_MM = 10.0  # largest scatter of the positions of one press
CLOCK_ROUNDING = 1e-6  # relative, of times that were written as decimals


@dataclass
class Recording:
    """N frames of M channels in order of capture, with the skin's properties as its owner states
    them.

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

    def __repr__(self) -> str:
        """The recording in a line."""
        kind = "query" if self.voltage is None else "recording"
        size = f"{len(self.frames)} frames of {len(self.channels)} channels"
        return f"<{kind} of {size}: {self.metadata['source']}>"

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
        """The skin as its owner states it."""
        return Skin.from_metadata(self.metadata["skin"])

    @property
    def n_electrodes(self) -> int:
        """Number of electrodes: of their places where known, else of those that channels name."""
        return _stated_count(self.metadata["skin"]) or int(self.channels.max()) + 1


def _stated_count(skin: dict) -> int | None:
    """Number of electrodes whose places a skin's metadata state; None: none are."""
    stated = (skin.get(key) for key in ELECTRODE_PLACES)
    return next((len(places) for places in stated if places is not None), None)


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

    Arguments are (N,) or one number for all frames, None where unknown. Untouched frames get force
    0 and NaN as place, probe and depth, whatever the arguments hold; forces other than 0 that they
    hold there become the column UNTOUCHED_FORCE, NaN where touched.
    """
    touch = np.asarray(touch, dtype=bool)
    columns = {
        "frame": np.arange(len(touch), dtype=np.int64),
        "time_s": np.asarray(time_s, dtype=float),
        "touch": touch,
    }
    label_values = {
        "x_mm": x_mm,
        "y_mm": y_mm,
        "force_N": force_N,
        "probe_mm": probe_mm,
        "depth_mm": depth_mm,
    }
    for name, values in label_values.items():
        values = np.nan if values is None else np.asarray(values, dtype=float)
        columns[name] = np.where(touch, values, 0.0 if name == "force_N" else np.nan)
    reported = np.nan if force_N is None else np.asarray(force_N, dtype=float)
    untouched_force = np.where(touch, np.nan, reported)
    if np.nan_to_num(untouched_force).any():
        columns[UNTOUCHED_FORCE] = untouched_force
    return pd.DataFrame(columns)


def voltages(recording: Recording, name: str | Path) -> np.ndarray:
    """The `voltage` (N, M) of a recording; raises InputError naming `name` for a query."""
    if recording.voltage is None:
        raise InputError(name, "column voltage_V", "nothing", "voltages; this is a query")
    return recording.voltage


def largest_force_N(recording: Recording) -> float:
    """The largest force of a recording, in N; 0 where none is known."""
    return float(recording.frames["force_N"].fillna(0.0).max())


def has_lengths(recording: Recording) -> bool:
    """Whether a length is known that tells how large the skin is: of it, or of a touch of known
    state. Without one, readings are alike at every scale. A sheet's thickness is none; a contact
    impedivity is one beside the conductivity."""
    skin, frames = recording.skin, recording.frames
    lengths = [skin.radius_mm, skin.outline, skin.electrode_xy_mm]
    lengths += [skin.electrode_width_mm or None, skin.electrode_height_mm]
    if skin.conductivity_S_per_m is not None and skin.electrode_width_mm != 0:
        lengths.append(skin.contact_impedivity_ohm_m2)
    states = frames.loc[frames["touch"], ["x_mm", "y_mm", "force_N", "probe_mm"]]
    has_touch = bool(states.notna().all(axis=1).any())
    return has_touch or any(length is not None for length in lengths)


def presses(recording: Recording) -> np.ndarray:
    """(N,) int: number of the press that each touched frame belongs to, -1 where untouched.

    By the `contact` column within a session where there is one, else by runs of touched frames at
    one place. Numbered 0, 1, 2, ... in order of appearance.
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
    """(N,): share of the recording's time elapsed at each frame, 0 to 1.

    By the frames' order where all times are equal.
    """
    time = frames["time_s"].to_numpy(float)
    if not np.ptp(time):
        time = np.arange(len(time), dtype=float)
    return (time - time[0]) / (float(np.ptp(time)) or 1.0)


def _changes(session: pd.Series) -> np.ndarray:
    names = session.to_numpy(dtype=object)
    return np.array([True, *(a != b for a, b in zip(names[1:], names[:-1], strict=True))])


def read(path: str | Path) -> Recording:
    """Read and validate a recording or a query.

    Raises InputError naming file, column or key, row, the value and the expected one.
    """
    schema, _ = parquet.layout(path)
    metadata = _read_metadata(path, schema.metadata or {})
    names = schema.names
    for name in names:
        if names.count(name) > 1:
            raise InputError(path, f"column {name}", f"{names.count(name)} of them", "one")
    width = len(metadata["channels"])
    _check_columns(path, schema, width)
    table = parquet.read(path, [name for name in names if name not in READINGS])
    plain = [name for name in names if name in COLUMNS or name in OPTIONAL_COLUMNS]
    frames = pd.DataFrame(
        {name: _scalar_column(path, name, table[name]) for name in plain},
        index=pd.RangeIndex(table.num_rows),
    )
    notes = table.select([name for name in names if name.startswith(NOTE)])
    options = {"types_mapper": pd.ArrowDtype, "ignore_metadata": True}
    frames = frames.join(parquet.frame(notes, **options))
    readings = {
        name: _reading_column(path, name, table.num_rows, width) if name in names else None
        for name in READINGS
    }
    touches = table["touches"].to_pylist() if "touches" in names else None
    recording = Recording(
        frames, readings["voltage_V"], readings["quadrature_V"], touches, metadata
    )
    validate(recording, path)
    return recording


def write(recording: Recording, path: str | Path) -> None:
    """Validate and write a recording atomically; equal recordings give equal bytes.

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
    **settings: str | float | None,
) -> dict:
    """The metadata of a recording of channels (M, 4) of a skin as `Skin.metadata`.

    `settings` are values of `position_frame` (by default "skin"), `frame_s` in seconds (None) and
    of the keys of DEFAULTS.
    """
    return {
        **DEFAULTS,
        "format": "eit-recording",
        "version": 1,
        "channels": np.asarray(channels).tolist(),
        "voltage": voltage,
        "frame_s": None,
        "position_frame": "skin",
        "source": source,
        "skin": skin,
        **settings,
    }


def validate(recording: Recording, file: str | Path) -> None:
    """Raise InputError naming `file` where the recording breaks a rule of the format."""
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
        is_huge = (values > LARGEST) | (values < -LARGEST)
        _check_rows(file, name, values, is_huge, f"finite, {LARGEST:g} at most, or NaN if lost")
    if recording.touches is not None:
        _check_touches(file, recording)
    _check_on_skin(file, recording)
    if recording.voltage is None:
        if recording.quadrature is not None:
            raise InputError(file, "column voltage_V", "nothing", "it beside quadrature_V")
        return
    if np.isnan(recording.voltage).all():
        raise InputError(file, "column voltage_V", "every channel lost", "some reading")
    largest = max(float(np.nanmax(recording.voltage)), -float(np.nanmin(recording.voltage)))
    if 0.0 < largest < 1.0 / LARGEST:
        violation = f"none larger than {largest:g}"
        raise InputError(file, "column voltage_V", violation, f"readings above {1.0 / LARGEST:g}")
    if metadata["values"] == "absolute":
        if metadata["voltage"] == "magnitude":
            negative = recording.voltage < 0
            _check_rows(file, "voltage_V", recording.voltage, negative, "magnitudes, 0 or more")
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
            known_keys = [*REQUIRED_KEYS, *DEFAULTS]
            raise InputError(file, f"key {key}", "an unknown key", f"one of {known_keys}")
    check_reading(metadata, file)
    if type(metadata["version"]) is not int or metadata["version"] != 1:
        raise InputError(file, "key version", json.dumps(metadata["version"]), "1")
    if not isinstance(metadata["source"], str) or not metadata["source"]:
        expected = "where the recording comes from"
        raise InputError(file, "key source", json.dumps(metadata["source"]), expected)
    skin = Skin.from_metadata(metadata["skin"], str(file))
    _check_channels(file, metadata["channels"], _stated_count(metadata["skin"]))
    _check_arcs(file, skin)


def check_reading(metadata: dict, file: str | Path) -> None:
    """Raise InputError naming `file` for an invalid value of `frame_s` or of a key of CHOICES.

    Keys may be missing.
    """
    for key, choices in CHOICES.items():
        if key in metadata and metadata[key] not in choices:
            expected = " or ".join(f'"{choice}"' for choice in choices)
            raise InputError(file, f"key {key}", json.dumps(metadata[key], default=str), expected)
    frame_s = metadata.get("frame_s")
    if frame_s is not None and not (is_number(frame_s) and frame_s > 0):
        violation = json.dumps(frame_s, default=str)
        raise InputError(file, "key frame_s", violation, f"more than 0 s, or null{hint(frame_s)}")


def _check_arcs(file: str | Path, skin: Skin) -> None:
    """Refuse electrodes that overlap; material and contacts of the skin are placeholders."""
    radius, angles, width = skin.radius_mm, skin.electrode_deg, skin.electrode_width_mm
    if radius is None or angles is None or width is None:
        return
    try:
        per_electrode = np.array(angles), np.array(width), np.array(1.0)
        Geometry(radius, 1.0, 1.0, *per_electrode, electrode_inside_mm=inside_mm(skin))
    except InputError as error:
        violation = f"{width} mm: {error.actual}"
        raise InputError(file, "skin.electrode_width_mm", violation, error.expected) from error


def _check_channels(file: str | Path, channels: object, n_electrodes: int | None) -> None:
    if not isinstance(channels, list) or not channels:
        raise InputError(file, "key channels", json.dumps(channels), "a list of channels")
    expected = "[source, sink, plus, minus], whole numbers"
    for row, channel in enumerate(channels):
        place = f"key channels, row {row}"
        is_integers = isinstance(channel, list) and all(
            type(electrode) is int for electrode in channel
        )
        if not is_integers or len(channel) != 4:
            raise InputError(file, place, json.dumps(channel), expected)
        for electrode in channel:
            max_electrodes = n_electrodes or MAX_ELECTRODES
            if not 0 <= electrode < max_electrodes:
                violation = f"electrode {electrode} of {n_electrodes or 'an unknown number'}"
                raise InputError(file, place, violation, f"electrodes 0 to {max_electrodes - 1}")
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


def _same_type(stored: pa.DataType, expected: pa.DataType) -> bool:
    if pa.types.is_fixed_size_list(expected):
        return (
            pa.types.is_fixed_size_list(stored)
            and stored.list_size == expected.list_size
            and stored.value_type == expected.value_type
        )
    if pa.types.is_list(expected):
        if not pa.types.is_list(stored) or not pa.types.is_struct(stored.value_type):
            return False
        fields = sorted((field.name, str(field.type)) for field in stored.value_type)
        return fields == sorted((field.name, str(field.type)) for field in expected.value_type)
    return stored == expected or (expected == pa.string() and stored == pa.large_string())


def _scalar_column(file: str | Path, name: str, column: pa.ChunkedArray) -> np.ndarray | pd.Series:
    if name in ("frame", "touch", "time_s") and column.null_count:
        row = column.is_null().to_pylist().index(True)
        raise InputError(file, f"column {name}, row {row}", "null", str(COLUMNS[name]))
    if name == "session":
        return pd.Series(column.to_pylist(), dtype=object)
    if name == "contact":
        return pd.Series(column.to_pylist(), dtype="Int64")
    return column.to_numpy()


def _reading_column(file: str | Path, name: str, count: int, width: int) -> np.ndarray:
    """(count, width) float64; a batch at a time, as whole columns stand in memory three times."""
    values = np.empty((count, width))
    start = 0
    for batch in parquet.batches(file, name):
        flat = batch.flatten()
        if batch.null_count or flat.null_count:
            nulls = batch.is_null().to_numpy(zero_copy_only=False)
            if not nulls.any():
                of_readings = flat.is_null().to_numpy(zero_copy_only=False)
                nulls = of_readings.reshape(-1, width).any(axis=1)
            row = start + int(np.flatnonzero(nulls)[0])
            place = f"column {name}, row {row}"
            raise InputError(file, place, "null", "a number, or NaN if lost")
        end = start + len(batch)
        values[start:end] = flat.to_numpy(zero_copy_only=False).reshape(-1, width)
        start = end
    return values


def _check_rows(
    file: str | Path, name: str, values: np.ndarray, is_bad: np.ndarray, expected: str
) -> None:
    """Raise InputError for the first bad value of a column (N,) or of readings (N, M)."""
    bad_indices = np.argwhere(is_bad)
    if len(bad_indices):
        row, *channel = bad_indices[0].tolist()
        bad_value = values[tuple(bad_indices[0])]
        channel_text = f" in channel {channel[0]}" if channel else ""
        raise InputError(file, f"column {name}, row {row}", f"{bad_value}{channel_text}", expected)


def _check_frames(file: str | Path, frames: pd.DataFrame) -> None:
    for name in COLUMNS:
        if name not in frames:
            raise InputError(file, f"column {name}", "nothing", f"it among {list(COLUMNS)}")
    for name in frames:
        if name not in COLUMNS and name not in OPTIONAL_COLUMNS and not name.startswith(NOTE):
            raise InputError(file, f"column {name}", "an unknown column", f"or {NOTE}...")

    def refuse(name: str, is_bad: np.ndarray, expected: str) -> None:
        _check_rows(file, name, frames[name].to_numpy(), is_bad, expected)

    frame = frames["frame"].to_numpy()
    refuse("frame", frame != np.arange(len(frame)), "0, 1, 2, ... in order")
    time = frames["time_s"].to_numpy(dtype=float)
    refuse("time_s", ~(time <= LARGEST) | (time < 0), "seconds from the recording's start")
    backwards = np.flatnonzero(np.diff(time) <= 0)
    if len(backwards):
        row = int(backwards[0]) + 1
        expected = f"more than {time[row - 1]}: time strictly increasing"
        raise InputError(file, f"column time_s, row {row}", time[row], expected)
    touch = frames["touch"].to_numpy(dtype=bool)
    for name in ("x_mm", "y_mm"):
        place = frames[name].to_numpy(dtype=float)
        refuse(
            name, touch & ~(np.abs(place) <= LARGEST), "the contact's centre where touch is true"
        )
        refuse(name, ~touch & ~np.isnan(place), "null where touch is false")
    force = frames["force_N"].to_numpy(dtype=float)
    refuse("force_N", ~touch & ~(np.isnan(force) | (force == 0)), "0 where touch is false")
    pressed = force[touch & np.isfinite(force) & (force != 0)]
    turned = "; all touched frames are negative: the axis points the other way, write -force_N"
    hint = turned if len(pressed) and (pressed < 0).all() else ""
    refuse("force_N", (force < 0) | (force > LARGEST), f"0 N or more, or null{hint}")
    probe = frames["probe_mm"].to_numpy(dtype=float)
    refuse("probe_mm", ~touch & ~np.isnan(probe), "null where touch is false")
    refuse("probe_mm", (probe <= 0) | (probe > LARGEST), "more than 0 mm, or null")
    depth = frames["depth_mm"].to_numpy(dtype=float)
    refuse("depth_mm", (depth < 0) | (depth > LARGEST), "0 mm or more, or null")
    if "temperature_C" in frames:
        warm = frames["temperature_C"].to_numpy(dtype=float)
        is_bad = (warm < ABSOLUTE_ZERO_C) | (warm > LARGEST)
        refuse("temperature_C", is_bad, f"more than {ABSOLUTE_ZERO_C} degrees, or null")
    if "contact" in frames:
        missing = frames["contact"].isna().to_numpy()
        refuse("contact", touch & missing, "the press where touch is true")


def _check_clock(file: str | Path, recording: Recording) -> None:
    """Refuse a `frame_s` longer than the shortest interval of a measured clock."""
    frame_s, time = recording.metadata["frame_s"], recording.frames["time_s"].to_numpy(dtype=float)
    if frame_s is None or recording.metadata["clock"] != "measured" or len(time) < 2:
        return
    row = int(np.argmin(np.diff(time)))
    min_interval_s = time[row + 1] - time[row]
    if frame_s > min_interval_s * (1.0 + CLOCK_ROUNDING):
        expected = f"at most {min_interval_s:.6g} s, the time from row {row} to row {row + 1}"
        raise InputError(file, "key frame_s", frame_s, expected)


def _check_contacts(file: str | Path, frames: pd.DataFrame) -> None:
    """Refuse a press, by session and `contact`, whose places scatter more than ONE_PRESS_MM."""
    if "contact" not in frames:
        return
    touched = frames[frames["touch"].to_numpy(dtype=bool)]
    press_keys = ["session", "contact"] if "session" in frames else ["contact"]
    places = touched.groupby(press_keys, sort=False, dropna=False)[["x_mm", "y_mm"]]
    offset_mm = (touched[["x_mm", "y_mm"]] - places.transform("first")).to_numpy(dtype=float)
    bad_rows = np.flatnonzero(np.hypot(*offset_mm.T) > ONE_PRESS_MM)
    if len(bad_rows):
        row = int(touched.index[bad_rows[0]])
        violation = (
            f"{touched['contact'][row]} again, {np.hypot(*offset_mm[bad_rows[0]]):.3g} mm away"
        )
        expected = f"one number a press, within {ONE_PRESS_MM:g} mm"
        raise InputError(file, f"column contact, row {row}", violation, expected)


def _check_on_skin(file: str | Path, recording: Recording) -> None:
    """Refuse touches outside the skin where its radius and frame are known.

    An unknown probe is assumed to be as large as the skin.
    """
    skin = recording.skin
    rim = skin.rim
    if not (rim or skin.radius_mm) or recording.metadata["position_frame"] != "skin":
        return
    if recording.touches is None:
        touch_table = recording.frames[list(TOUCH_KEYS)].assign(row=recording.frames["frame"])
    else:
        numbered = enumerate(recording.touches)
        all_touches = [
            {**touch, "row": row}
            for row, frame_touches in numbered
            for touch in frame_touches or []
        ]
        touch_table = pd.DataFrame(all_touches, columns=[*TOUCH_KEYS, "row"])
    x_mm, y_mm = (touch_table[key].to_numpy(float) for key in ("x_mm", "y_mm"))
    radius = skin.radius_mm or 0.0
    size = rim.perimeter_mm / np.pi if rim else 2.0 * radius
    reach = 0.5 * touch_table["probe_mm"].astype(float).fillna(size).to_numpy()
    distance = np.hypot(x_mm, y_mm)
    beyond = rim.beyond(x_mm + 1j * y_mm) if rim else distance - radius
    bad_rows = np.flatnonzero(beyond > reach)
    if len(bad_rows):
        place = f"columns x_mm, y_mm, row {int(touch_table['row'].iloc[bad_rows[0]])}"
        if rim:
            violation = f"a touch {beyond[bad_rows[0]]:.6g} mm off the skin"
            expected = f"at most {reach[bad_rows[0]]:.6g} mm: probe and skin must meet"
            raise InputError(file, place, violation, expected)
        violation = f"a touch {distance[bad_rows[0]]:.6g} mm from the centre"
        expected = (
            f"at most {radius + reach[bad_rows[0]]:.6g} mm: probe and skin, radius {radius:g},"
            " must meet"
        )
        most = radius + reach
        if (
            np.nanmin([x_mm, y_mm]) >= 0
            and not (np.hypot(x_mm - radius, y_mm - radius) > most).any()
        ):
            expected += "; no place is negative: counted from the corner, subtract the radius"
        raise InputError(file, place, violation, expected)


def _check_touches(file: str | Path, recording: Recording) -> None:
    frames = recording.frames
    assert recording.touches is not None
    if len(recording.touches) != len(frames):
        row_count = f"{len(recording.touches)} rows"
        raise InputError(file, "column touches", row_count, f"{len(frames)}, one a frame")
    touched = frames["touch"].to_numpy(dtype=bool)
    column_touches = frames[list(TOUCH_KEYS)].to_numpy(dtype=float)
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
        first_touch = np.array([_number(touches[0][key]) for key in TOUCH_KEYS])
        if not np.array_equal(first_touch, column_touches[row], equal_nan=True):
            raise InputError(file, place, touches[0], "first the touch of the plain columns")


def _check_touch(file: str | Path, place: str, touch: dict | None) -> None:
    if not isinstance(touch, dict) or set(touch) != set(TOUCH_KEYS):
        raise InputError(file, place, touch, f"{{{', '.join(TOUCH_KEYS)}}}")
    x, y, force, probe = (_number(touch[key]) for key in TOUCH_KEYS)
    if not (abs(x) <= LARGEST and abs(y) <= LARGEST):
        raise InputError(file, place, touch, "a place, x_mm and y_mm")
    if force < 0 or force > LARGEST:
        raise InputError(file, place, touch, "force_N 0 or more, or null")
    if probe <= 0 or probe > LARGEST:
        raise InputError(file, place, touch, "probe_mm more than 0, or null")


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
