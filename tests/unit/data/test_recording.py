import copy
import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.data import recording
from eitskin.data.importers.description import describe
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table


@pytest.fixture
def written(make_recording, tmp_path):
    """The path of a valid recording."""
    path = tmp_path / "skin.parquet"
    recording.write(make_recording(), path)
    return path


def rewritten(path, columns=None, metadata=None, drop=()):
    """`path` with columns (name -> pyarrow array) and metadata keys exchanged, below the writer's
    guard.
    """
    table = pq.read_table(path)
    text = json.loads(table.schema.metadata[b"eit"])
    for name, array in (columns or {}).items():
        if name in table.column_names:
            table = table.set_column(table.column_names.index(name), name, array)
        else:
            table = table.append_column(name, array)
    table = table.drop_columns(list(drop))
    text = {key: value for key, value in (text | (metadata or {})).items() if value is not ...}
    pq.write_table(table.replace_schema_metadata({b"eit": json.dumps(text).encode()}), path)
    return path


def refusal(path) -> str:
    """The one message with which the reader refuses; the file stays as it was."""
    original_bytes = path.read_bytes()
    with pytest.raises(InputError) as caught:
        recording.read(path)
    assert path.read_bytes() == original_bytes
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    assert ": found " in message and ", expected " in message
    return message


def changed(path, name, row, value):
    """`path` with one scalar exchanged."""
    column = pq.read_table(path)[name]
    values = column.to_pylist()
    values[row] = value
    return rewritten(path, {name: pa.array(values, type=column.type)})


def assert_same(recording_1, recording_2):
    pd.testing.assert_frame_equal(recording_1.frames, recording_2.frames, check_dtype=False)
    np.testing.assert_array_equal(recording_1.voltage, recording_2.voltage)
    assert recording_1.metadata == recording_2.metadata


def test_what_is_written_is_read_back_and_its_bytes_repeat(make_recording, written, tmp_path):
    read_back = recording.read(written)
    assert_same(make_recording(), read_back)
    assert read_back.touches is None and read_back.quadrature is None
    second_path = tmp_path / "again.parquet"
    recording.write(read_back, second_path)
    assert second_path.read_bytes() == written.read_bytes()


def test_every_optional_column_comes_back(full_recording, tmp_path):
    path = tmp_path / "full.parquet"
    recording.write(full_recording, path)
    read_back = recording.read(path)
    assert_same(full_recording, read_back)
    np.testing.assert_array_equal(read_back.quadrature, full_recording.quadrature)
    assert read_back.touches == full_recording.touches
    recording.write(read_back, tmp_path / "again.parquet")
    assert (tmp_path / "again.parquet").read_bytes() == path.read_bytes()


def test_a_query_has_no_readings(make_recording, tmp_path):
    query = make_recording()
    query.voltage = None
    recording.write(query, tmp_path / "query.parquet")
    assert "voltage_V" not in pq.read_schema(tmp_path / "query.parquet").names
    assert recording.read(tmp_path / "query.parquet").voltage is None


def test_a_query_needs_no_untouched_frame(make_recording, tmp_path):
    query = make_recording()
    query.frames = query.frames[query.frames["touch"]].reset_index(drop=True)
    query.frames["frame"] = np.arange(len(query.frames))
    query.voltage = None
    recording.write(query, tmp_path / "query.parquet")
    assert recording.read(tmp_path / "query.parquet").frames["touch"].all()


def test_nan_is_a_lost_reading(make_recording, tmp_path):
    skin_recording = make_recording()
    skin_recording.voltage[3, 7] = np.nan
    recording.write(skin_recording, tmp_path / "lost.parquet")
    read_back = recording.read(tmp_path / "lost.parquet")
    assert np.isnan(read_back.voltage[3, 7]) and np.isnan(read_back.voltage).sum() == 1


def test_defaults_are_filled_in(written):
    left_out = dict.fromkeys(["values", "unit", "clock", "source_reference"], ...)
    metadata = recording.read(rewritten(written, metadata=left_out)).metadata
    assert metadata["values"] == "absolute" and metadata["unit"] == "V"
    assert metadata["clock"] == "measured" and metadata["source_reference"] == "floating"


def test_differences_need_no_untouched_frame_and_may_be_negative_magnitudes(written):
    table = pq.read_table(written)
    touched = table.filter(table["touch"])
    frame = pa.array(np.arange(len(touched)))
    pq.write_table(touched.set_column(0, "frame", frame), written)
    rewritten(written, metadata={"values": "difference", "voltage": "magnitude"})
    assert (recording.read(written).voltage < 0).any()


@pytest.mark.parametrize("name", list(recording.COLUMNS))
def test_a_missing_column_is_named(written, name):
    assert f"column {name}: found nothing" in refusal(rewritten(written, drop=[name]))


def test_an_unknown_column_is_named_and_a_note_is_carried(written):
    numbers = pa.array(np.arange(len(pq.read_table(written))))
    rewritten(written, {"note_mood": numbers})
    assert recording.read(written).frames["note_mood"].tolist() == numbers.to_pylist()
    message = refusal(rewritten(written, {"mood": numbers}))
    assert "column mood: found an unknown column" in message


def test_a_column_twice_is_named(written):
    table = pq.read_table(written)
    pq.write_table(table.append_column("x_mm", table["x_mm"]), written)
    assert "column x_mm: found 2 of them, expected one" in refusal(written)


@pytest.mark.parametrize(
    ("name", "invalid"), [("x_mm", pa.string()), ("time_s", pa.float32()), ("frame", pa.int32())]
)
def test_a_wrong_type_is_named(written, name, invalid):
    column = pq.read_table(written)[name].combine_chunks()
    violation = refusal(rewritten(written, {name: column.cast(invalid)}))
    assert f"column {name}: found {invalid}" in violation


def test_readings_of_another_width_or_kind_are_named(written):
    voltage = pq.read_table(written)["voltage_V"].combine_chunks()
    plain = pa.array(voltage.to_pylist())
    assert "expected fixed_size_list<double>[208]" in refusal(
        rewritten(written, {"voltage_V": plain})
    )
    narrow = pa.FixedSizeListArray.from_arrays(voltage.flatten()[: 2 * len(voltage)], 2)
    assert "expected fixed_size_list<double>[208]" in refusal(
        rewritten(written, {"voltage_V": narrow})
    )


def test_null_readings_are_named_with_their_row(written):
    width = 208
    values = pq.read_table(written)["voltage_V"].to_pylist()
    values[4] = [None] * width
    array = pa.array(values, type=pa.list_(pa.float64(), width))
    assert "column voltage_V, row 4: found null" in refusal(
        rewritten(written, {"voltage_V": array})
    )
    values[4] = None
    array = pa.array(values, type=pa.list_(pa.float64(), width))
    assert "column voltage_V, row 4: found null" in refusal(
        rewritten(written, {"voltage_V": array})
    )


@pytest.mark.parametrize(
    ("name", "row", "value", "expected"),
    [
        ("frame", 3, 4, "0, 1, 2"),
        ("time_s", 5, 1.0, "time strictly increasing"),
        ("time_s", 5, 2.0, "time strictly increasing"),
        ("time_s", 0, -1.0, "seconds from the recording's start"),
        ("time_s", 2, None, "double"),
        ("time_s", 2, np.inf, "seconds"),
        ("touch", 2, None, "bool"),
        ("touch", 0, True, "the contact's centre"),
        ("x_mm", 0, 3.0, "null where touch is false"),
        ("y_mm", 11, None, "the contact's centre where touch is true"),
        ("force_N", 0, 2.0, "0 where touch is false"),
        ("force_N", 11, -2.0, "0 N or more"),
        ("probe_mm", 0, 10.0, "null where touch is false"),
        ("probe_mm", 11, 0.0, "more than 0 mm"),
        ("depth_mm", 11, -1.0, "0 mm or more"),
    ],
)
def test_a_wrong_value_is_named_with_its_row(written, name, row, value, expected):
    message = refusal(changed(written, name, row, value))
    invalid = "x_mm" if name == "touch" and value else name
    assert f"column {invalid}, row {row}: found" in message and expected in message


def test_unknown_force_probe_and_depth_are_null(written):
    changed(written, "force_N", 11, None)
    changed(written, "probe_mm", 11, None)
    frames = recording.read(written).frames
    assert frames.loc[11, ["force_N", "probe_mm", "depth_mm"]].isna().all()


def test_infinite_readings_and_negative_magnitudes_are_named(make_recording, written):
    skin_recording = make_recording()
    skin_recording.voltage[2, 5] = np.inf
    with pytest.raises(InputError, match="column voltage_V, row 2: found inf in channel 5"):
        recording.write(skin_recording, written)
    assert "expected magnitudes" in refusal(rewritten(written, metadata={"voltage": "magnitude"}))


def test_every_channel_lost_is_refused(make_recording, tmp_path):
    skin_recording = make_recording()
    skin_recording.voltage[:] = np.nan
    with pytest.raises(InputError, match="found every channel lost"):
        recording.write(skin_recording, tmp_path / "lost.parquet")
    assert not list(tmp_path.iterdir())


def test_no_untouched_frame_among_absolute_values_is_refused(written):
    table = pq.read_table(written)
    touched = table.filter(table["touch"])
    frame = pa.array(np.arange(len(touched)))
    pq.write_table(touched.set_column(0, "frame", frame), written)
    assert "at least one untouched frame among absolute values" in refusal(written)


def test_no_rows_are_refused(written):
    pq.write_table(pq.read_table(written).slice(0, 0), written)
    assert "rows: found none" in refusal(written)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("format", "eit", '"eit-recording"'),
        ("version", 2, "1"),
        ("version", True, "1"),
        ("voltage", "rms", '"signed" or "magnitude"'),
        ("values", "relative", '"absolute" or "difference"'),
        ("unit", "mV", '"V" or "ohm" or "arbitrary"'),
        ("clock", None, '"measured" or "index"'),
        ("position_frame", "base", '"skin" or "robot"'),
        ("source_reference", "", '"floating" or "sink-grounded"'),
        ("source", "", "where the recording comes from"),
        ("frame_s", 0, "more than 0 s, or null"),
        ("frame_s", "0.35", "more than 0 s, or null"),
        ("channels", [], "a list of channels"),
        ("skin", ..., "it among"),
        ("voltage", ..., "it among"),
        ("untis", "V", "one of"),
    ],
)
def test_a_wrong_key_is_named(written, key, value, expected):
    message = refusal(rewritten(written, metadata={key: value}))
    assert f"key {key}" in message and expected in message


@pytest.mark.parametrize(
    ("channel", "violation"),
    [
        ([0, 1, 15, 16], "electrode 16 of 16"),
        ([0, 1, -1, 3], "electrode -1 of 16"),
        ([4, 4, 6, 7], "a pair with itself"),
        ([4, 5, 7, 7], "a pair with itself"),
        ([0, 1, 2], "found [0, 1, 2]"),
        ([0, 1, 2, 3.0], "whole numbers"),
    ],
)
def test_a_wrong_channel_is_named_with_its_row(written, channel, violation):
    channels = channel_table(16).tolist()
    channels[9] = channel
    message = refusal(rewritten(written, metadata={"channels": channels}))
    assert "key channels, row 9" in message and violation in message


def test_a_wrong_belief_of_the_skin_is_named(make_recording, written):
    skin = copy.deepcopy(make_recording().metadata["skin"])
    skin["radius_mm"] = -80
    assert "skin.radius_mm: found -80" in refusal(rewritten(written, metadata={"skin": skin}))


@pytest.mark.parametrize(
    ("key", "value", "violation"),
    [
        ("electrode_width_mm", 31.5, "31.5 mm: two that overlap"),
        ("electrode_deg", [0.0, 0.1, *np.arange(2, 16) * 22.5], "5.0 mm: two that overlap"),
        ("electrode_deg", [], "no angle"),
        ("radius_mm", 10**400, "10000"),
        ("electrode_deg", [10**400] * 16, "[10000"),
    ],
)
def test_a_skin_that_cannot_be_is_refused(make_recording, written, key, value, violation):
    skin = make_recording().metadata["skin"] | {"electrode_width_mm": 5.0}
    rewritten(written, metadata={"skin": skin})
    assert recording.read(written).skin.electrode_width_mm == 5.0
    message = refusal(rewritten(written, metadata={"skin": skin | {key: value}}))
    assert f": found {violation}" in message


def test_a_frame_may_not_last_longer_than_to_the_next(written):
    assert recording.read(rewritten(written, metadata={"frame_s": 0.5})).metadata["frame_s"] == 0.5
    message = refusal(rewritten(written, metadata={"frame_s": 0.51}))
    assert "key frame_s: found 0.51, expected at most 0.5 s, the time from row 0 to" in message
    assert "key frame_s" in refusal(rewritten(written, metadata={"frame_s": 10**400}))
    rewritten(written, metadata={"frame_s": 0.51, "clock": "index"})
    assert recording.read(written).metadata["frame_s"] == 0.51


def test_electrodes_that_no_skin_has_are_refused(make_recording, written):
    skin = make_recording().metadata["skin"] | {"electrode_deg": None}
    channels = [[0, 1, 2, 10**9], *channel_table(16).tolist()[1:]]
    message = refusal(rewritten(written, metadata={"skin": skin, "channels": channels}))
    assert "key channels, row 0: found electrode 1000000000 of an unknown number" in message


@pytest.mark.parametrize(
    ("x_mm", "probe_mm", "is_valid"), [(84.9, 10.0, True), (85.1, 10.0, False)]
)
@pytest.mark.parametrize("frame", ["skin", "robot"])
def test_a_touch_must_meet_the_skin(make_recording, tmp_path, x_mm, probe_mm, is_valid, frame):
    skin_recording = make_recording()
    skin_recording.metadata["position_frame"] = frame
    skin_recording.frames.loc[[12, 13], ["x_mm", "y_mm", "probe_mm"]] = x_mm, 0.0, probe_mm
    if is_valid or frame == "robot":
        recording.write(skin_recording, tmp_path / "skin.parquet")
    else:
        with pytest.raises(
            InputError, match=r"row 12: found a touch 85\.1 mm from the centre, exp"
        ):
            recording.write(skin_recording, tmp_path / "skin.parquet")
    skin_recording.metadata["skin"]["radius_mm"] = None
    recording.write(skin_recording, tmp_path / "skin.parquet")


def test_an_unknown_probe_is_at_most_as_large_as_the_skin(make_recording, tmp_path):
    skin_recording = make_recording()
    skin_recording.frames.loc[12, ["x_mm", "probe_mm"]] = 500.0, np.nan
    with pytest.raises(InputError, match=r"row 12: found a touch .* expected at most 160 mm"):
        recording.write(skin_recording, tmp_path / "skin.parquet")


def test_every_one_of_several_touches_must_meet_the_skin(full_recording, tmp_path):
    row = int(np.flatnonzero(full_recording.frames["touch"])[0])
    far = {"x_mm": 0.0, "y_mm": -90.0, "force_N": 1.0, "probe_mm": 10.0}
    full_recording.touches[row].append(far)
    with pytest.raises(InputError, match=f"row {row}: found a touch 90 mm from the centre"):
        recording.write(full_recording, tmp_path / "touches.parquet")


def test_one_contact_may_scatter_by_millimetres(full_recording, tmp_path):
    full_recording.touches = None
    touch = full_recording.frames["touch"].to_numpy()
    scatter = np.random.default_rng(1).uniform(-3.0, 3.0, touch.sum())
    full_recording.frames.loc[touch, "x_mm"] += scatter
    recording.write(full_recording, tmp_path / "contact.parquet")
    frames = recording.read(tmp_path / "contact.parquet").frames
    assert frames["contact"].equals(full_recording.frames["contact"])


def test_one_contact_at_several_places_is_refused(full_recording, tmp_path):
    touch = full_recording.frames["touch"]
    rows = np.flatnonzero(touch)
    full_recording.touches = None
    full_recording.frames.loc[rows[1], "x_mm"] += 0.5
    recording.write(full_recording, tmp_path / "skin.parquet")
    full_recording.frames.loc[touch, "contact"] = 1
    with pytest.raises(InputError, match=r"column contact, row \d+: found 1 again, [\d.]+ mm away"):
        recording.write(full_recording, tmp_path / "contact.parquet")
    full_recording.frames["session"] = [f"{k}" for k in full_recording.frames["frame"]]
    recording.write(full_recording, tmp_path / "sessions.parquet")


def test_files_that_are_no_recording_are_refused(written, tmp_path):
    complete_bytes = written.read_bytes()
    written.write_bytes(complete_bytes[: len(complete_bytes) // 2])
    assert "an end cut off" in refusal(written)
    written.write_bytes(complete_bytes[:200] + b"\0" * 400 + complete_bytes[600:])
    assert refusal(written)
    flipped = bytearray(complete_bytes)
    flipped[len(complete_bytes) // 3] ^= 1
    written.write_bytes(bytes(flipped))
    assert "damaged data" in refusal(written)
    written.write_bytes(b"a,b\n1,2\n")
    assert "expected a Parquet file" in refusal(written)
    written.write_bytes(b"")
    assert "expected a Parquet file" in refusal(written)
    pq.write_table(pa.table({"frame": [1]}), written)
    assert "schema key eit: found nothing" in refusal(written)
    with pytest.raises(InputError, match="no such file"):
        recording.read(tmp_path / "absent.parquet")
    with pytest.raises(InputError, match="found a folder"):
        recording.read(tmp_path)


def test_metadata_that_is_no_json_object_is_refused(written):
    table = pq.read_table(written)
    deep = b"[" * 100_000
    for text, violation in ((b"{", "no JSON"), (deep, "no JSON"), (b"[]", "found list")):
        pq.write_table(table.replace_schema_metadata({b"eit": text}), written)
        assert violation in refusal(written)


def test_touches_begin_with_the_plain_columns(full_recording, tmp_path):
    path = tmp_path / "touches.parquet"
    row = int(np.flatnonzero(full_recording.frames["touch"])[0])
    second = {"x_mm": 1.0, "y_mm": 2.0, "force_N": None, "probe_mm": None}
    valid_touches = copy.deepcopy(full_recording.touches)
    valid_touches[row].append(second)
    full_recording.touches = valid_touches
    recording.write(full_recording, path)
    assert recording.read(path).touches[row][1] == second
    for invalid, place in (
        ([second, valid_touches[row][0]], row),
        ([], row),
        ([{**valid_touches[row][0], "force_N": -1.0}], row),
        ([valid_touches[row][0], {**second, "x_mm": None}], row),
        ([valid_touches[row][0]], 0),
    ):
        full_recording.touches = [*valid_touches[:place], invalid, *valid_touches[place + 1 :]]
        with pytest.raises(InputError, match=f"column touches, row {place}"):
            recording.write(full_recording, path)


def test_a_touch_without_its_press_is_refused(full_recording, tmp_path):
    row = int(np.flatnonzero(full_recording.frames["touch"])[0])
    full_recording.frames.loc[row, "contact"] = pd.NA
    with pytest.raises(InputError, match=f"column contact, row {row}"):
        recording.write(full_recording, tmp_path / "contact.parquet")


def touched_frames(places, touch) -> Recording:
    touch = np.array(touch, dtype=bool)
    frames = frames_table(np.arange(len(touch)), touch, np.array(places, float), 0.0)
    metadata = describe(channel_table(16), even_angles(16), "simulation", "signed")
    return Recording(frames, None, None, None, metadata)


def test_presses_are_runs_at_one_place():
    skin_recording = touched_frames([0, 1, 1, 2, 0, 2, 2], [0, 1, 1, 1, 0, 1, 1])
    assert recording.presses(skin_recording).tolist() == [-1, 0, 0, 1, -1, 2, 2]
    skin_recording.frames["session"] = ["a"] * 6 + ["b"]
    assert recording.presses(skin_recording).tolist() == [-1, 0, 0, 1, -1, 2, 3]


def test_presses_are_contacts_within_a_session_where_given():
    skin_recording = touched_frames([0, 1, 2, 2, 0, 1, 1], [0, 1, 1, 1, 0, 1, 1])
    skin_recording.frames["contact"] = pd.Series([None, 5, 5, 9, None, 5, 3], dtype="Int64")
    assert recording.presses(skin_recording).tolist() == [-1, 0, 0, 1, -1, 0, 2]
    skin_recording.frames["session"] = ["a"] * 4 + ["b"] * 3
    assert recording.presses(skin_recording).tolist() == [-1, 0, 0, 1, -1, 2, 3]


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 2)), min_size=1, max_size=30))
def test_presses_count_up_through_touched_frames(states):
    touch, places = zip(*states, strict=True)
    label = recording.presses(touched_frames(places, touch))
    assert ((label >= 0) == np.array(touch)).all()
    counted = label[label >= 0]
    assert set(np.diff(np.concatenate([[-1], counted]))) <= {0, 1}
    for press_number in set(counted):
        assert len({places[k] for k in np.flatnonzero(label == press_number)}) == 1
