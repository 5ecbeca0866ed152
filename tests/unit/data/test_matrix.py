"""Plain matrices with a description beside them, and what is said where there is none."""

import numpy as np
import pandas as pd
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.data import check, importers, recording
from eitskin.data.channel_order import ORDERS, in_order
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table, every_channel, undriven
from homogeneous_skin import PHASE, potentials, readings

ADJACENT = {"drive": "adjacent", "measurement": "adjacent"}


def frames(count=3, n=8, order=None):
    """(count, n (n - 3)) of an even skin, adjacent pairs."""
    channels = channel_table(n)
    channels = channels if order is None else in_order("file", order, channels, n)
    return np.linspace(1.0, 1.1, count)[:, None] * readings(channels, n)


def lines(table, separator=",", comma=False, names=None):
    rows = [separator.join(map(repr, row)) for row in np.asarray(table, dtype=float).tolist()]
    rows = [row.replace(".", ",") for row in rows] if comma else rows
    return "\n".join(([separator.join(names)] if names else []) + rows) + "\n"


@pytest.fixture
def write(tmp_path):
    """A function that writes a file and, where it is given, its description."""

    def write_(content, description=None, name="skin.csv", encoding="utf-8"):
        path = tmp_path / name
        if isinstance(content, dict):
            np.savez(path, **content)
        elif isinstance(content, np.ndarray):
            np.save(path, content)
        else:
            path.write_bytes(content if isinstance(content, bytes) else content.encode(encoding))
        path.with_suffix(".yaml").unlink(missing_ok=True)
        if description is not None:
            text = description if isinstance(description, str) else yaml.safe_dump(description)
            path.with_suffix(".yaml").write_text(text, encoding="utf-8")
        return path

    return write_


def refused(path, match, **settings):
    with pytest.raises(InputError, match=match) as caught:
        importers.load(path, **settings)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --- the same numbers in every dress

DRESSES = {
    "commas": lambda v: (lines(v), "skin.csv", "utf-8"),
    "a mark": lambda v: ("\ufeff" + lines(v), "skin.csv", "utf-8"),
    "Windows": lambda v: (lines(v).replace("\n", "\r\n"), "skin.csv", "utf-8"),
    "tabs": lambda v: (lines(v, "\t"), "skin.tsv", "utf-8"),
    "spaces": lambda v: ("# made by numpy\n" + lines(v, " "), "skin.txt", "utf-8"),
    "semicolons": lambda v: (lines(v, ";"), "skin.csv", "utf-8"),
    "decimal commas": lambda v: (lines(v, ";", comma=True), "skin.csv", "utf-8"),
    "decimal commas and tabs": lambda v: (lines(v, "\t", comma=True), "skin.csv", "utf-8"),
    "UTF-16": lambda v: (lines(v), "skin.csv", "utf-16"),
    "named": lambda v: (lines(v, names=[f"v{k}" for k in range(len(v[0]))]), "skin.csv", "utf-8"),
    "trailing": lambda v: (lines(v).replace("\n", ",\n"), "skin.csv", "utf-8"),
    "npy": lambda v: (v, "skin.npy", None),
    "npz": lambda v: ({"anything": v}, "skin.npz", None),
}


@pytest.mark.parametrize("dress", DRESSES)
def test_the_same_numbers_in_every_dress(write, dress):
    content, name, encoding = DRESSES[dress](frames())
    imported_recording = importers.load(write(content, ADJACENT, name, encoding))
    np.testing.assert_array_equal(imported_recording.voltage, frames())
    np.testing.assert_array_equal(imported_recording.channels, channel_table(8))
    assert (
        imported_recording.metadata["clock"] == "index"
        and "taken for untouched" in imported_recording.metadata["source"]
    )
    assert check.check(imported_recording).ok


@settings(max_examples=30, deadline=None)
@given(
    n=st.sampled_from([8, 12]),
    drive=st.sampled_from(["adjacent", "opposite", "skip-2"]),
    measure=st.sampled_from(["adjacent", "skip-1", "adjacent-reversed"]),
    order=st.sampled_from([None, *ORDERS]),
    with_driven=st.booleans(),
    phase=st.sampled_from([1.0, PHASE]),
)
def test_any_protocol_comes_back(tmp_path_factory, n, drive, measure, order, with_driven, phase):
    path = tmp_path_factory.mktemp("matrix") / "skin.npy"
    base = measure.removesuffix("-reversed")
    channels = every_channel(n, drive, base) if with_driven else channel_table(n, drive, base)
    channels = channels[:, [0, 1, 3, 2]] if measure.endswith("-reversed") else channels
    channels = channels if order is None else in_order("file", order, channels, n)
    np.save(path, phase * readings(channels, n)[None])
    description = {"drive": drive, "measurement": measure} | ({"order": order} if order else {})
    path.with_suffix(".yaml").write_text(yaml.safe_dump(description))
    imported_recording = importers.load(path)
    free = [not set(row[:2]) & set(row[2:]) for row in channels.tolist()]
    np.testing.assert_array_equal(imported_recording.channels, channels[free])
    expected = phase * readings(channels, n)[free]
    read = (
        imported_recording.voltage
        if imported_recording.quadrature is None
        else imported_recording.voltage + 1j * imported_recording.quadrature
    )
    np.testing.assert_allclose(read[0], expected, rtol=1e-12)
    assert not check.check(imported_recording).of_topic("polarity")
    assert all(
        finding.severity != check.ERROR
        for finding in check.check(imported_recording).of_topic("order")
    )


def test_channels_may_be_listed(write):
    table = channel_table(8, "skip-2", "skip-1")[::3]
    description = {"electrodes": 8, "measurement": table.tolist()}
    imported_recording = importers.load(write(readings(table, 8)[None], description, "skin.npy"))
    np.testing.assert_array_equal(imported_recording.channels, table)
    path = write(readings(table, 8)[None], description | {"drive": "adjacent"}, "skin.npy")
    refused(path, "key drive: found 'adjacent' beside a list of channels")
    path = write(readings(table, 8)[None], {"measurement": table[1:].tolist()}, "skin.npy")
    refused(path, f"{len(table) - 1} channels, expected {len(table)}, one a number")


# --- the description


def test_what_the_description_says_is_the_recordings(write):
    description = {
        **ADJACENT,
        "electrodes": 8,
        "voltage": "magnitude",
        "unit": "ohm",
        "values": "absolute",
        "position_frame": "robot",
        "rate_Hz": 20,
        "frame_s": 0.04,
        "source": "bench 3",
        "skin": {"radius_mm": 60.0, "electrode_width_mm": 4, "electrode_z_mm": 2.0},
    }
    imported_recording = importers.load(write(np.abs(frames()), description, "skin.npy"))
    metadata = imported_recording.metadata
    assert [metadata[key] for key in ("voltage", "unit", "clock", "position_frame", "frame_s")] == [
        "magnitude",
        "ohm",
        "measured",
        "robot",
        0.04,
    ]
    np.testing.assert_allclose(imported_recording.frames["time_s"], [0.0, 0.05, 0.1])
    assert (
        imported_recording.skin.radius_mm == 60.0 and imported_recording.skin.electrode_z_mm == 2.0
    )
    assert (
        imported_recording.skin.thickness_mm is None
        and len(imported_recording.skin.electrode_deg) == 8
    )
    assert metadata["source"].startswith("bench 3 (matrix skin.npy; no touches are said")


MISTAKES = {
    "drives: adjacent\nmeasurement: adjacent": r"skin\.yaml: key drives: found an unknown key, ex",
    "drive: adjacent\nmeasurement: 3": "key measurement: found 3",
    "drive: adjacent\nmeasurement: adjacent\nunit: dV": 'key unit: found "dV", expected "V"',
    "drive: adjacent\nmeasurement: adjacent\nrate_Hz: 0": "key rate_Hz: found 0",
    "drive: adjacent\nmeasurement: adjacent\nclock: measured": "rate_Hz, or a label time_s",
    "drive: adjacent\nmeasurement: adjacent\nelectrodes: 16": "found 40, expected 104 or 208 or",
    "drive: adjacent\nmeasurement: adjacent\nelectrodes: many": "key electrodes: found 'many'",
    "drive: adjacent\nmeasurement: adjacent\norder: up": "order: found 'up', expected one of",
    "drive: adjacent\nmeasurement: adjacent\nskin: {radius: 3}": "skin.radius: found an unkn",
    "drive: adjacent\nmeasurement: adjacent\nskin: round": "key skin: found 'round'",
    "drive: adjacent\nmeasurement: adjacent\nskin: {electrode_deg: [0, 9]}": "found 2 angles",
    "drive: adjacent\nmeasurement: adjacent\nvoltage: magnitude": "magnitudes, 0 or more",
    "drive: adjacent\nmeasurement: adjacent\nframe_s: long": "key frame_s",
    "drive: [1]\nmeasurement: adjacent": r"key drive: found \[1\], expected a word",
    "measurement: adjacent": "key drive: found nothing",
    "drive: adjacent": r"no skin\.yaml that says what its 40 columns read",
    "drive: {adjacent": "found the end of the file, expected ',' or '}'",
    "- adjacent": "found a list, expected a mapping",
    "drive: adjacent\nmeasurement: adjacent\nlabels: 3": "key labels: found 3",
    "drive: adjacent\nmeasurement: adjacent\nlabels: absent.csv": "no file 'absent.csv'",
    "drive: adjacent\nmeasurement: adjacent\nlabels: {z: 3}": r"labels\.z: found an unknown label",
    "drive: adjacent\nmeasurement: adjacent\nlabels: {x_mm: 90}": "labels.x_mm: found 90",
}


@pytest.mark.parametrize("description", MISTAKES)
@pytest.mark.parametrize("name", ["skin.csv", "skin.npy"])
def test_a_mistake_in_the_description_is_one_line(write, description, name):
    content = lines(frames()) if name == "skin.csv" else frames()
    refused(write(content, description, name), MISTAKES[description])


def test_what_is_taken_for_magnitudes_is_said(write):
    guessed = "taken for magnitudes, as `voltage` is not stated"
    imported_recording = importers.load(write(np.abs(frames()), ADJACENT, "skin.npy"), "matrix")
    assert (
        imported_recording.metadata["voltage"] == "magnitude"
        and guessed in imported_recording.metadata["source"]
    )
    imported_recording = importers.load(write(-np.abs(frames()), ADJACENT, "skin.npy"), "matrix")
    assert (
        imported_recording.metadata["voltage"] == "signed"
        and guessed not in imported_recording.metadata["source"]
    )
    signed = ADJACENT | {"voltage": "signed"}
    imported_recording = importers.load(write(np.abs(frames()), signed, "skin.npy"), "matrix")
    assert (
        imported_recording.metadata["voltage"] == "signed"
        and guessed not in imported_recording.metadata["source"]
    )


def test_pairs_may_come_from_the_caller(write):
    path = write(frames(), None, "skin.npy")
    settings = {"drive": "adjacent", "measure": "adjacent"}
    imported_recording = importers.load(path, "matrix", **settings)
    np.testing.assert_array_equal(imported_recording.channels, channel_table(8))
    path = write(frames(), {"electrodes": 8, "unit": "V"}, "skin.npy")
    assert importers.load(path, **settings).metadata["unit"] == "V"
    path = write(frames(), ADJACENT, "skin.npy")
    refused(
        path, r"skin\.yaml: key drive: found 'adjacent', and 'adjacent' given beside it", **settings
    )


@pytest.mark.parametrize(
    ("unit", "recorded_unit", "size"), [("mV", "V", 1e-3), ("µV", "V", 1e-6), ("kohm", "ohm", 1e3)]
)
def test_readings_in_a_prefixed_unit_are_converted(write, unit, recorded_unit, size):
    path = write(frames(), {"electrodes": 8, **ADJACENT, "unit": unit}, "skin.npy")
    recording = importers.load(path)
    assert recording.metadata["unit"] == recorded_unit
    assert np.array_equal(recording.readings, size * frames())


@pytest.mark.parametrize(
    ("line", "place"),
    [
        ("skin: {current_A: 1e-3}", r"skin\.current_A"),
        ("skin: {electrode_deg: [0, 1e-3, 45, 90, 135, 180, 225, 270]}", r"skin\.electrode_deg"),
        ("frame_s: 1e-3", "key frame_s"),
        ("rate_Hz: 1e-3", "key rate_Hz"),
    ],
)
def test_an_exponent_without_a_point_is_refused_with_the_number_to_write(write, line, place):
    described = f"electrodes: 8\ndrive: adjacent\nmeasurement: adjacent\n{line}\n"
    assert "write 1.0e-3" in refused(write(frames(), described, "skin.npy"), place)


def test_names_that_people_give_to_labels_are_guessed_and_one_letter_in_common_is_not(write):
    table = np.column_stack([np.zeros((3, 6)), frames(3)])
    names = ["px", "py", "tip", "fz", "tint", "Touched", *(f"ch{k}" for k in range(40))]
    message = refused(write(lines(table, names=names), {"electrodes": 8, **ADJACENT}), "columns")
    labels = "x_mm: px, y_mm: py, probe_mm: tip, force_N: fz, note_tint: tint, touch: Touched"
    assert f"labels: {{{labels}}}" in message


def test_columns_that_say_their_unit_are_converted_and_bare_ones_are_not_taken(write):
    place = [np.nan, 0.5, 0.5]
    table = np.column_stack([[0, 40, 90], place, place, [0, 4, 4], [0, 900, 950], frames(3)])
    names = ["t [ms]", "px (cm)", "py_cm", "tip_mm", "Fz_mN", *(f"ch{k}" for k in range(40))]
    described = {"electrodes": 8, **ADJACENT}
    recording = importers.load(write(lines(table, names=names), described))
    columns = ["time_s", "x_mm", "y_mm", "probe_mm", "force_N"]
    assert recording.frames[columns].to_numpy()[2] == pytest.approx([0.09, 5.0, 5.0, 4.0, 0.95])
    assert "px (cm) taken for x_mm" in recording.metadata["source"]
    refused(write(lines(table, names=["t", "px", *names[2:]]), described), "columns t, px beside")
    twice = [names[0], "px (cm)", "x_pos (cm)", *names[3:]]
    refused(write(lines(table, names=twice), described), r"columns px \(cm\), x_pos \(cm\) beside")


def test_a_unit_alone_tells_times_forces_and_readings_whatever_the_language(write):
    place = [np.nan, 5.0, 5.0]
    table = np.column_stack([[0, 40, 90], place, place, [0, 4, 4], [0, 900, 950], frames(3)])
    names = ["Zeit (ms)", "X", "Y", "Stempel (mm)", "Kraft (mN)"]
    names += [f"Kanal {k} (mV)" for k in range(40)]
    content = lines(table, ";", names=names, comma=True).replace("Kanal", "Känal").encode("cp1252")
    message = refused(write(content, None), "columns X, Y, Stempel")
    example = message.split("to be corrected: ")[1]
    recording = importers.load(write(content, example))
    columns = ["time_s", "x_mm", "probe_mm", "force_N"]
    assert recording.frames[columns].to_numpy()[2] == pytest.approx([0.09, 5.0, 4.0, 0.95])
    assert recording.metadata["unit"] == "V"
    np.testing.assert_allclose(recording.readings, 1e-3 * frames(3))
    stated = {**yaml.safe_load(example), "unit": "uV"}
    np.testing.assert_allclose(importers.load(write(content, stated)).readings, 1e-6 * frames(3))
    refused(write(content + "9;ä".encode("cp1252"), example), "no UTF-8, expected UTF-8 .in Excel")


def test_units_below_the_names_and_a_clock_are_read(write):
    times = ["2026-11-03 14:02:00", "2026-11-03 14:02:00.6", "2026-11-03 14:03:00"]
    rows = [[time, "4", *map(str, row)] for time, row in zip(times, frames(3), strict=True)]
    head = [["when", "F", *(f"ch{k}" for k in range(40))], ["", "N", *["mV"] * 40]]
    recording = importers.load(write("\n".join(map(",".join, head + rows)), ADJACENT))
    assert recording.frames["time_s"].tolist() == pytest.approx([0.0, 0.6, 60.0])
    assert "when taken for time_s" in recording.metadata["source"]
    np.testing.assert_allclose(recording.readings, 1e-3 * frames(3))
    again = "\n".join(map(",".join, head + rows + head[:1]))
    refused(write(again, ADJACENT), "names again")
    refused(write(again, None, "skin.txt"), "names again")


def test_an_instrument_s_word_for_no_reading_is_a_lost_reading(write):
    text = lines(frames(), names=[f"ch{k}" for k in range(40)])
    spoilt = "\n".join(
        line.rsplit(",", 1)[0] + ",ovf" if k else line for k, line in enumerate(text.splitlines())
    )
    recording = importers.load(write(spoilt, ADJACENT))
    assert np.isnan(recording.readings[:, -1]).all() and recording.readings.shape[1] == 40


def test_the_proposal_can_be_copied_whatever_the_names_and_leaves_named_channels_alone(write):
    table = np.column_stack([[np.nan, 5, 5], [np.nan, 5, 5], [1, 2, 3], frames(3)])
    names = ["px", "py", "who: [no]", *(f"ch{k}" for k in range(40))]
    content = lines(table, names=names)
    example = refused(write(content, None), "columns").split("to be corrected: ")[1]
    assert importers.load(write(content, example)).frames["x_mm"][1] == 5.0
    pairs = ["_".join(f"E{electrode + 1}" for electrode in row) for row in channel_table(8)[::-1]]
    content = lines(table, names=[*names[:2], "who", *pairs])
    example = refused(write(content, None), "columns").split("to be corrected: ")[1]
    recording = importers.load(write(content, example))
    np.testing.assert_array_equal(recording.channels, channel_table(8)[::-1])


# --- without a description


@pytest.mark.parametrize(
    ("width", "table"),
    [
        (208, channel_table(16)),
        (40, channel_table(8)),
        (104, channel_table(16)[channel_table(16)[:, 0] < channel_table(16)[:, 2]]),
        (192, channel_table(16, "opposite")),
        (32, channel_table(8, "opposite")),
    ],
)
@pytest.mark.parametrize("name", ["skin.csv", "skin.npy"])
def test_the_example_in_the_message_can_be_copied(write, width, table, name):
    values = np.random.default_rng(0).normal(size=(3, width))
    content = lines(values) if name == "skin.csv" else values
    message = refused(write(content, None, name), f"no skin.yaml that says what its {width} col")
    example = message.split("for example ")[1]
    imported_recording = importers.load(write(content, example, name))
    np.testing.assert_array_equal(imported_recording.channels, table)


@pytest.mark.parametrize("description", [None, {"electrodes": 8, **ADJACENT}])
def test_columns_of_other_names_are_told_and_the_example_can_be_copied(write, description):
    place = [np.nan, 5, 5]
    table = np.column_stack([np.arange(3), place, place, [0, 4, 4], [1, 2, 3], frames(3)])
    names = ["t", "X", "Y", "force", "who", *(f"ch{k}" for k in range(40))]
    content = lines(table, names=names)
    message = refused(
        write(content, description), "columns: found columns t, X, Y, force, who beside 40"
    )
    example = message.split("to be corrected: ")[1]
    assert "labels: {time_s: t, x_mm: X, y_mm: Y, force_N: force, note_who: who}" in example
    imported_recording = importers.load(write(content, example))
    placed = imported_recording.frames[["x_mm", "y_mm", "force_N"]].to_numpy()
    assert placed.tolist()[1:] == [[5.0, 5.0, 4.0]] * 2
    np.testing.assert_array_equal(imported_recording.channels, channel_table(8))


def test_widths_of_no_known_protocol_ask_for_a_list(write):
    values = np.ones((2, 120))
    refused(write(values, None, "skin.npy"), "one for every two of 16 electrodes is no four-elec")
    refused(write(lines(values[:, :77])), r"77 channels in the columns' order")


def test_channels_x_frames_are_told_to_be_turned(write):
    for content, name in ((lines(frames().T), "skin.csv"), (frames(9).T, "skin.npy")):
        width = 3 if name == "skin.csv" else 9
        refused(write(content, None, name), f"40 rows of {width} numbers, expected a frame a row")


@pytest.mark.parametrize("name", ["skin.txt", "skin.npy"])
def test_one_column_is_one_frame(write, name):
    content = frames(1)[0] if name == "skin.npy" else lines(frames(1).T)
    imported_recording = importers.load(write(content, ADJACENT, name))
    np.testing.assert_array_equal(imported_recording.voltage, frames(1))
    undescribed = importers.load(write(content, None, name))
    np.testing.assert_array_equal(undescribed.voltage, frames(1))


def test_a_whole_matrix_needs_no_description(write):
    values = readings(every_channel(16, "adjacent", "adjacent"), 16)[None]
    imported_recording = importers.load(write(values, None, "skin.npy"))
    assert (
        imported_recording.voltage.shape == (1, 208)
        and "48 numbers a frame at" in imported_recording.metadata["source"]
    )
    turned = in_order("", "drive-plus-ascending-own", every_channel(16, *ADJACENT.values()), 16)
    path = write(readings(turned, 16)[None], ADJACENT, "skin.npy")
    refused(path, "order: found one in which .* --order ")


def test_four_columns_are_somebody_elses_unless_described(write):
    """The four columns of PyEIDORS keep their format; a description beside them comes first."""
    values = np.random.default_rng(0).normal(size=(208, 4))
    assert "PyEIDORS" in importers.load(write(lines(values))).metadata["source"]
    listed_channels = {"measurement": [[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5], [3, 4, 5, 6]]}
    imported_recording = importers.load(write(lines(values), listed_channels))
    assert imported_recording.voltage.shape == (208, 4)
    path = write(lines(values), {"unrelated": 1})
    assert "PyEIDORS" in importers.load(path).metadata["source"]


# --- what files say themselves


def pattern_frames(n, drive, measure, with_driven, count=2):
    """(count, M): noisy magnitudes of an even skin."""
    channels = every_channel(n, drive, measure) if with_driven else channel_table(n, drive, measure)
    noise = 1 + 0.005 * np.random.default_rng(n).normal(size=(count, len(channels)))
    return np.abs(readings(channels, n)) * noise


@pytest.mark.parametrize("with_driven", [False, True])
@pytest.mark.parametrize(
    ("n", "drive", "measure"),
    [
        (8, "adjacent", "adjacent"),
        (8, "opposite", "opposite"),
        (16, "opposite", "opposite"),
        (8, "skip-1", "skip-1"),
        (16, "skip-4", "skip-4"),
        (16, "skip-2", "adjacent"),
        (16, "opposite", "adjacent"),
        (32, "opposite", "opposite"),
        (32, "skip-3", "skip-3"),
    ],
)
def test_a_pattern_is_known_by_the_readings(write, n, drive, measure, with_driven):
    values = pattern_frames(n, drive, measure, with_driven)
    imported_recording = importers.load(write(lines(values), None))
    np.testing.assert_array_equal(imported_recording.channels, channel_table(n, drive, measure))
    assert (
        f"by the readings {n} electrodes, {drive} drive, measurement {measure}"
        in imported_recording.metadata["source"]
    )


def test_numbers_at_driven_electrodes_choose_no_pattern(write):
    """Zeros there are nearer, by correlation alone, to what another pattern would read of a disc,
    which takes them for readings."""
    channels = every_channel(8, "skip-1", "skip-1")
    values = pattern_frames(8, "skip-1", "skip-1", True) * undriven(channels)
    refused(write(lines(values), None), "that says what its 64 columns read")


def test_readings_of_no_skin_are_not_taken_for_one(write):
    noise = np.random.default_rng(5).uniform(size=(40, 224))
    message = refused(write(lines(noise), None), "that says what its 224 columns read")
    assert "{electrodes: 16, drive: opposite, measurement: opposite}" in message


@pytest.mark.parametrize(("n", "drive"), [(8, "adjacent"), (16, "adjacent"), (16, "opposite")])
@pytest.mark.parametrize("stated", [None, "adjacent", "ground"])
def test_potentials_against_ground_are_differenced(write, n, drive, stated):
    step = {"adjacent": 1, "opposite": n // 2}[drive]
    values = np.concatenate([potentials((k, (k + step) % n), n).real for k in range(n)])
    description = stated and {"electrodes": n, "drive": drive, "measurement": stated}
    imported_recording = importers.load(write(np.stack([values, values]), description, "skin.npy"))
    table = channel_table(n, drive, "adjacent")
    np.testing.assert_array_equal(imported_recording.channels, table)
    expected = (potentials((0, step), n)[table[0, 2]] - potentials((0, step), n)[table[0, 3]]).real
    np.testing.assert_allclose(imported_recording.voltage[:, 0], expected, rtol=1e-9)
    assert "potentials against ground" in imported_recording.metadata["source"]


SPELLINGS = {
    "Python": lambda z: f"({z.real:.17g}{z.imag:+.17g}j)",
    "MATLAB": lambda z: f"{z.real:.17g}{z.imag:+.17g}i",
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_complex_numbers_in_text(write, spelling):
    values = PHASE * frames()
    text = "\n".join(",".join(map(SPELLINGS[spelling], row)) for row in values)
    imported_recording = importers.load(write(text, ADJACENT))
    assert imported_recording.quadrature is not None
    np.testing.assert_allclose(imported_recording.voltage, values.real)
    np.testing.assert_allclose(imported_recording.quadrature, values.imag)
    assert "in-phase and quadrature" in check.text(check.check(imported_recording))


@pytest.mark.parametrize("parts", ["Magnitude Phase", "mag phase_rad", "Re Im"])
def test_columns_that_name_electrodes_need_no_description(write, parts):
    table = channel_table(16, "opposite", "opposite")
    values = PHASE * np.ones((40, 1)) * readings(table, 16)
    pair = {
        "Magnitude Phase": (np.abs(values), np.angle(values, deg=True)),
        "mag phase_rad": (np.abs(values), np.angle(values)),
        "Re Im": (values.real, values.imag),
    }[parts]
    names = [
        "_".join(f"E{electrode + 1:02d}" for electrode in row) + f"_{part}"
        for row in table
        for part in parts.split()
    ]
    columns = np.stack(pair, axis=2).reshape(40, -1)
    imported_recording = importers.load(write(lines(columns, names=names), None))
    np.testing.assert_array_equal(imported_recording.channels, table)
    assert imported_recording.quadrature is not None
    np.testing.assert_allclose(imported_recording.voltage, values.real, rtol=1e-6, atol=1e-9)


def rows_of_readings(first=1, n=8):
    table = channel_table(n)
    return pd.DataFrame(
        [
            (frame, *(channel + first), value)
            for frame, row in enumerate(frames(2, n))
            for channel, value in zip(table, row, strict=True)
        ],
        columns=["frame", "a", "b", "m", "n", "r"],
    )


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("with_frames", [True, False])
def test_a_reading_a_row(write, first, with_frames):
    table = rows_of_readings(first)
    table = table if with_frames else table.drop(columns="frame")
    imported_recording = importers.load(write(table.to_csv(index=False), None))
    np.testing.assert_array_equal(imported_recording.channels, channel_table(8))
    np.testing.assert_allclose(imported_recording.voltage, frames(2))
    assert imported_recording.metadata["unit"] == "ohm"
    for names in (["src", "sink", "vp", "vn"], ["a", "b", "m", "n"]):
        unnamed = rows_of_readings(first).set_axis(["frame", *names, "rhoa"], axis=1)
        refused(write(unnamed.to_csv(index=False), None), f"found {', '.join(names)}, as of a read")
    twice = pd.concat([rows_of_readings(first), rows_of_readings(first).iloc[:1]])
    refused(write(twice.to_csv(index=False), None), "again in frame 0, expected each once")


@pytest.mark.parametrize("n", [8, 16])
@pytest.mark.parametrize("mark", ["", "s\n", "every"])
@pytest.mark.parametrize("description", [False, True])
def test_a_frame_over_several_lines(write, n, mark, description):
    drives = frames(3, n).reshape(3 * n, n - 3)
    blocks = [lines(drives[n * k : n * k + n], " ") for k in range(3)]
    text = "".join("frame\n" * (mark == "every") + block for block in blocks)
    text = text if mark == "every" else mark + text
    stated = {"electrodes": n, **ADJACENT} if description else None
    imported_recording = importers.load(write(text, stated, "rec.txt"))
    np.testing.assert_allclose(imported_recording.voltage, frames(3, n))


def test_a_log_of_openeit_alone_and_in_another_table(write):
    logged = [f"magnitudes : {line}" for line in lines(frames()).splitlines()]
    merged = "Time,Tag,EIT\n" + "".join(
        f'{k}.5,,"0.00\n{line}\n"\n' for k, line in enumerate(logged)
    )
    dated = "timestamp;EIT\n" + "".join(
        f'2021-03-16 03:37:0{2 * k}.500;"{line}"\n' for k, line in enumerate(logged)
    )
    for text, seconds in (("\n".join(logged), None), (merged, 1.0), (dated, 2.0)):
        imported_recording = importers.load(write(text, None, "log.csv"))
        np.testing.assert_allclose(imported_recording.voltage, frames())
        assert "OpenEIT's log" in imported_recording.metadata["source"]
        is_timed = imported_recording.metadata["clock"] == "measured"
        assert is_timed == (seconds is not None)
        times = (seconds or 1.0) * np.arange(3)
        np.testing.assert_allclose(imported_recording.frames["time_s"], times)


@pytest.mark.parametrize("name", ["", "Unnamed: 0"])
def test_a_column_that_counts_the_rows_is_left_out(write, name):
    table = pd.concat([labels(), pd.DataFrame(frames(6)).add_prefix("v")], axis=1)
    path = write(table.to_csv(index_label=name or None), ADJACENT)
    imported_recording = importers.load(path)
    assert "the column that counts the rows left out" in imported_recording.metadata["source"]
    np.testing.assert_allclose(imported_recording.voltage, frames(6))


def test_an_unnamed_column_is_named_by_its_number(write):
    text = lines(
        np.column_stack([[3.5, 1.5, 2.5], frames()]), names=["", *map("v{}".format, range(40))]
    )
    assert "{note_0: 0}" in refused(write(text, ADJACENT), "columns: found columns 0 beside 40")


@pytest.mark.parametrize("name", ["ref", "homg", "h", "empty", "background"])
def test_of_several_arrays_the_reference_or_the_named_one_is_read(write, name):
    path = write({name: frames(), "target": 2 * frames()}, ADJACENT, "skin.npz")
    np.testing.assert_array_equal(importers.load(path).voltage, frames())
    np.testing.assert_array_equal(importers.load(path, array="target").voltage, 2 * frames())
    assert "target left out" in importers.load(path).metadata["source"]
    refused(path, "array: found 'x', expected one of", array="x")


SLIPS = {
    "decimal commas": (lines(frames()).replace(".", ","), "semicolons or tabs between the numbers"),
    "decimal commas, rounded": (
        "\n".join(",".join(f"{value:.3f}" for value in row) for row in -frames()).replace(".", ","),
        "found decimal commas, and commas between the numbers",
    ),
    "turned": (lines(frames().T), "perhaps turned: its 40 rows would fit"),
    "cut in the first cell": (
        lines(frames()) + "0.0",
        "line 4: found 1 cells, expected 40; where the log",
    ),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_of_the_writer_is_named(write, slip):
    text, match = SLIPS[slip]
    refused(write(text, ADJACENT), match)


def test_normalised_differences_ask_for_the_untouched_frame(write):
    refused(
        write(frames(), {**ADJACENT, "values": "normalised"}, "skin.npy"),
        "key values: found normalised, expected difference: multiply each channel by the size",
    )


# --- labels


def labels():
    """Six frames: two untouched, four of two presses."""
    return pd.DataFrame(
        {
            "time_s": [100.0, 100.5, 101.0, 101.6, 102.0, 102.5],
            "touch": [0, 1, 1, 0, 1, 1],
            "x_mm": [np.nan, 10.0, 10.0, np.nan, -20.0, -20.0],
            "y_mm": [np.nan, 5.0, 5.0, np.nan, 0.0, 0.0],
            "force_N": [0.0, 1.0, 2.0, 0.0, 1.5, 3.0],
            "probe_mm": [np.nan, 10.0, 10.0, np.nan, 10.0, 10.0],
            "contact": [np.nan, 4, 4, np.nan, 5, 5],
            "session": ["a", "a", "a", "b", "b", "b"],
            "temperature_C": [21.0, 21.0, 21.0, 21.5, 21.5, 21.5],
        }
    )


def in_a_file(write, tmp_path):
    labels().to_csv(tmp_path / "where.csv", index=False)
    return write(frames(6), {**ADJACENT, "labels": "where.csv"}, "skin.npy")


def in_columns(write, tmp_path):
    table = pd.concat([labels(), pd.DataFrame(frames(6)).add_prefix("v")], axis=1)
    return write(table.to_csv(index=False), ADJACENT)


def in_arrays(write, tmp_path):
    arrays = {name: labels()[name].to_numpy() for name in labels() if name != "session"}
    arrays["session"] = np.array(list("aaabbb"))
    return write({"voltage": frames(6), **arrays}, ADJACENT, "skin.npz")


@pytest.mark.parametrize("way", [in_a_file, in_columns, in_arrays])
def test_labels_in_a_file_in_columns_and_in_arrays(write, tmp_path, way):
    path = way(write, tmp_path)
    imported_recording = importers.load(path)
    np.testing.assert_allclose(imported_recording.voltage, frames(6))
    np.testing.assert_allclose(imported_recording.frames["time_s"], [0.0, 0.5, 1.0, 1.6, 2.0, 2.5])
    for name in ("x_mm", "y_mm", "force_N", "probe_mm", "temperature_C"):
        np.testing.assert_allclose(imported_recording.frames[name], labels()[name])
    assert imported_recording.frames["session"].tolist() == list("aaabbb")
    assert recording.presses(imported_recording).tolist() == [-1, 0, 0, -1, 1, 1]
    assert imported_recording.frames["contact"].tolist()[1:3] == [4, 4]
    assert (
        imported_recording.metadata["clock"] == "measured"
        and "untouched" not in imported_recording.metadata["source"]
    )
    recording.write(imported_recording, tmp_path / "skin.parquet")
    read = importers.load(tmp_path / "skin.parquet")
    pd.testing.assert_frame_equal(
        read.frames[["x_mm", "touch"]], imported_recording.frames[["x_mm", "touch"]]
    )
    assert importers.files(path)[1:] == [
        tmp_path / "skin.yaml",
        *([tmp_path / "where.csv"] if way is in_a_file else []),
    ]


def test_notes_are_carried(write, tmp_path):
    """What is neither a reading nor a label of the contract need not be cut out."""
    table = pd.DataFrame(frames(3)).add_prefix("v")
    table.insert(0, "clock", ["10:00:01", "10:00:02", "10:00:03"])
    table.insert(1, "note_operator", ["A", "B", "A"])
    imported_recording = importers.load(write(table.to_csv(index=False), ADJACENT))
    assert imported_recording.frames["note_clock"].tolist()[
        2
    ] == "10:00:03" and imported_recording.voltage.shape == (3, 40)
    recording.write(imported_recording, tmp_path / "skin.parquet")
    assert importers.load(tmp_path / "skin.parquet").frames["note_operator"].tolist() == list("ABA")


def test_a_label_that_stands_twice_is_refused(write):
    table = pd.concat([labels(), pd.DataFrame(frames(6)).add_prefix("v")], axis=1)
    path = write(table.rename(columns={"v3": "x_mm"}).to_csv(index=False), ADJACENT)
    refused(path, "line of names: found 2 of x_mm, expected one")


def test_labels_by_the_number_of_their_column(write):
    place = labels()[["x_mm", "y_mm"]].to_numpy()
    table = np.hstack([frames(6), place])
    description = {**ADJACENT, "labels": {"x_mm": 40, "y_mm": 41}}
    for path in (write(table, description, "skin.npy"), write(lines(table), description)):
        imported_recording = importers.load(path)
        assert imported_recording.frames["touch"].tolist() == [False, True, True, False, True, True]
        np.testing.assert_array_equal(imported_recording.frames["x_mm"], place[:, 0])
        assert (
            imported_recording.frames["force_N"].isna().tolist()
            == imported_recording.frames["touch"].tolist()
        )


@pytest.mark.parametrize(
    ("name", "values", "match"),
    [
        ("time_s", [1, 2, 3, 3, 4, 5], r"time_s, row 3: found 3.0, expected more than 3.0"),
        ("time_s", [1, 2, 3, 2, 4, 5], r"time_s, row 3: found 2.0"),
        ("time_s", [1, 2, "", 3, 4, 5], "time_s, row 2: found nan"),
        ("touch", [0, 1, "perhaps", 0, 1, 1], "label touch, row 2: found 'perhaps'"),
        ("contact", ["", 1.5, 1, "", 2, 2], "label contact, row 1: found 1.5"),
        ("x_mm", ["", "left", 1, "", 1, 1], "line 3, column x_mm: found 'left', expected a number"),
        ("x_mm", ["", "", 1, "", 1, 1], "x_mm, row 1: found nan"),
        ("force_N", [0, -1, 1, 0, 1, 1], "force_N, row 1: found -1.0"),
    ],
)
def test_labels_that_are_none_are_refused(write, tmp_path, name, values, match):
    table = labels().astype(object)
    table[name] = values
    table.to_csv(tmp_path / "where.csv", index=False)
    path = write(frames(6), {**ADJACENT, "labels": "where.csv"}, "skin.npy")
    refused(path, match)


def test_forces_that_point_the_other_way_are_told(write):
    table = labels().assign(force_N=-labels()["force_N"])
    table = pd.concat([table, pd.DataFrame(frames(6)).add_prefix("v")], axis=1)
    refused(
        write(table.to_csv(index=False), ADJACENT), "the axis points the other way, write -force_N"
    )


def test_places_counted_from_the_skin_s_corner_are_told(write):
    table = labels().assign(x_mm=labels()["x_mm"] + 60, y_mm=labels()["y_mm"] + 60)
    table = pd.concat([table, pd.DataFrame(frames(6)).add_prefix("v")], axis=1)
    path = write(table.to_csv(index=False), {**ADJACENT, "skin": {"radius_mm": 60.0}})
    refused(path, "no place is negative: counted from the corner, subtract the radius")


def test_labels_that_do_not_belong_to_the_frames_are_refused(write, tmp_path):
    labels().to_csv(tmp_path / "where.csv", index=False)
    description = {**ADJACENT, "labels": "where.csv"}
    refused(
        write(frames(5), description, "skin.npy"),
        "label time_s: found 6 rows, expected 5, as frames",
    )
    path = write(frames(6), description | {"rate_Hz": 3}, "skin.npy")
    refused(path, "rate_Hz: found it beside time_s")
    for text in ("x_mm,z_mm\n1,2\n", "1.5,2\n3,4\n", "x_mm,x_mm\n1,2\n"):
        (tmp_path / "where.csv").write_text(text)
        refused(path, r"where\.csv: line of names: found '(z_mm||x_mm)', expected names among")


# --- broken files

TEXT = lines(frames())
MAX_MISFIT = {
    "cut": (TEXT[:-30].encode(), "line 3: found 3. cells, expected 40"),
    "a word": (TEXT.replace("\n", "\nlost ", 1).encode(), "line 2, column 0: found 'lost "),
    "a word at first": (b"x," + TEXT.split(",", 1)[1].encode(), "line 1: found 'x', expected num"),
    "infinity": (TEXT.replace("\n", "\ninf,", 1).encode(), "line 2"),
    "no text": (
        TEXT.encode() + b"\xff\xfe\xfa\n",
        "line 4: found byte 0xff, no UTF-8, expected UTF-8",
    ),
    "UTF-16 unmarked": (TEXT.encode("utf-16-le"), "UTF-16 without a byte-order mark"),
    "nothing": (b"", "no line of cells"),
    "names alone": (",".join(f"v{k}" for k in range(40)).encode(), "no row below the names"),
    "columns counted": (
        (",".join(map(str, range(40))) + "\n" + TEXT).encode(),
        "the columns' numbers, 0 to 39",
    ),
    "points and commas": (
        lines(frames(), ";", comma=True).replace(",", ".", 1).encode(),
        "line 1: found both, expected decimal points or decimal commas",
    ),
}


@pytest.mark.parametrize("name", MAX_MISFIT)
def test_a_broken_text_is_refused(write, name):
    content, match = MAX_MISFIT[name]
    refused(write(content, ADJACENT), match)


@pytest.mark.parametrize("name", ["no text", "UTF-16 unmarked", "nothing", "columns counted"])
def test_a_broken_text_is_refused_without_a_description_too(write, name):
    content, match = MAX_MISFIT[name]
    refused(write(content), match)
    if name != "columns counted":
        refused(write(content, None, "skin.dat"), "format: found .*, expected one of eit-recording")


def test_broken_arrays_are_refused(write, tmp_path):
    path = write(frames(), ADJACENT, "skin.npy")
    complete_bytes = path.read_bytes()
    for size in (8, 60, len(complete_bytes) - 8):
        path.write_bytes(complete_bytes[:size])
        refused(path, "a damaged or cut file")
    path = write({"a": frames(), "b": frames()}, ADJACENT, "skin.npz")
    refused(path, r"a \(3, 40\), b \(3, 40\), expected one .*, or --array NAME")
    path = write({"a": frames(), "b": frames()}, None, "skin.npz")
    refused(path, r"a \(3, 40\), b \(3, 40\), expected one .*, or --array NAME")
    np.testing.assert_array_equal(importers.load(path, array="b").voltage, frames())
    path.write_bytes(path.read_bytes()[:-40])
    refused(path, "a damaged or cut file")
    np.save(tmp_path / "skin.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    refused(tmp_path / "skin.npy", "one of objects")
    refused(write(np.zeros((0, 40)), ADJACENT, "skin.npy"), "0 frames of 40 numbers")
    refused(write({"v": frames(), "x_mm": np.array(list("abc"))}, ADJACENT, "skin.npz"), "x_mm")


def test_lost_readings_are_lost(write):
    path = write("\n".join([TEXT.split("\n")[0], "nan," + "," * 38]), ADJACENT)
    imported_recording = importers.load(path)
    assert (
        np.isnan(imported_recording.voltage[1]).all()
        and np.isfinite(imported_recording.voltage[0]).all()
    )
