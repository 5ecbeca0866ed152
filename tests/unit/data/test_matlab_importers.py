"""EIDORS's and the Kuopio challenge's MATLAB files from samples written here."""

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.data import check, importers
from eitskin.data.channel_order import in_order
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table, every_channel
from homogeneous_skin import PHASE, readings


def refused(path, match, **settings):
    with pytest.raises(InputError, match=match) as caught:
        importers.load(path, **settings)
    assert "\n" not in str(caught.value)


# --- EIDORS


def stimulation(channels, n, sparse):
    """EIDORS's `stimulation` of channels (M, 4) that stand drive by drive."""
    drives = np.unique(channels[:, 0])
    patterns = np.zeros((1, len(drives)), dtype=[("stim_pattern", "O"), ("meas_pattern", "O")])
    for k, source in enumerate(drives):
        rows = channels[channels[:, 0] == source]
        drive, measured = np.zeros((n, 1)), np.zeros((len(rows), n))
        drive[rows[0, 0]], drive[rows[0, 1]] = 1e-3, -1e-3
        for j, (plus, minus) in enumerate(rows[:, 2:]):
            measured[j, plus], measured[j, minus] = 1.0, -1.0
        make = scipy.sparse.csc_array if sparse else np.asarray
        patterns[0, k] = make(drive), make(measured)
    return patterns


@pytest.mark.parametrize("sparse", [True, False])
@pytest.mark.parametrize(
    ("n", "drive", "measure", "order"),
    [
        (16, "adjacent", "adjacent", None),
        (16, "adjacent", "adjacent", "drive-plus-ascending-own"),
        (16, "opposite", "adjacent", None),
        (16, "skip-4", "skip-4", None),
        (8, "skip-1", "adjacent", None),
        (32, "opposite", "opposite", None),
    ],
)
def test_the_stimulation_in_the_file_is_the_channel_table(
    tmp_path, n, drive, measure, order, sparse
):
    table = channel_table(n, drive, measure)
    table = table if order is None else in_order("", order, table, n)
    values = readings(table, n)[:, None] * np.ones(3)
    path = tmp_path / "tank.mat"
    model = {"stimulation": stimulation(table, n, sparse), "nodes": np.zeros((4, 2))}
    scipy.io.savemat(path, {"vv": {"meas": values, "fwd_model": model}})
    imported_recording = importers.load(path)
    np.testing.assert_array_equal(imported_recording.channels, table)
    np.testing.assert_allclose(imported_recording.voltage, values.T)
    assert "channels by fwd_model.stimulation" in imported_recording.metadata["source"]


def test_a_stimulation_of_many_electrodes_is_refused(tmp_path):
    patterns = stimulation(channel_table(16), 16, False)
    patterns[0, 2]["stim_pattern"] = np.cos(np.arange(16.0))[:, None]
    path = tmp_path / "tank.mat"
    scipy.io.savemat(path, {"vh": frames(), "fmdl": {"stimulation": patterns}})
    refused(path, r"stimulation\(3\)\.stim_pattern: found 16 electrodes .*expected two of opp")
    assert importers.load(path, drive="adjacent").voltage.shape == (1, 208)


def eidors_channels(n, with_driven=False):
    """A homogeneous disc reads positive: u[j+1] - u[j] with current entering at k."""
    table = every_channel(n, "adjacent", "adjacent") if with_driven else channel_table(n)
    return table[:, [0, 1, 3, 2]]


def frames(n=16, count=1, with_driven=False, order=None):
    """(rows, count): readings of an even skin, a frame a column."""
    channels = eidors_channels(n, with_driven)
    channels = channels if order is None else in_order("file", order, channels, n)
    return readings(channels, n)[:, None] * np.linspace(1.0, 1.1, count)


@settings(max_examples=15, deadline=None)
@given(
    n=st.sampled_from([8, 16, 32]),
    count=st.sampled_from([1, 5]),
    with_driven=st.booleans(),
    phase=st.sampled_from([1.0, PHASE]),
    name=st.sampled_from(["vh", "v_homg", "eit.data", "meas", "vv"]),
    transposed=st.booleans(),
)
def test_frames_of_any_name(tmp_path_factory, n, count, with_driven, phase, name, transposed):
    path = tmp_path_factory.mktemp("mat") / "tank.mat"
    values = phase * frames(n, count, with_driven)
    outer, _, field = name.partition(".")
    array = values.T if transposed else values
    scipy.io.savemat(path, {outer: {field: array, "name": "a tank"} if field else array})
    imported_recording = importers.load(path)
    np.testing.assert_array_equal(imported_recording.channels, eidors_channels(n))
    expected = phase * frames(n, count).T
    read = (
        imported_recording.voltage
        if imported_recording.quadrature is None
        else imported_recording.voltage + 1j * imported_recording.quadrature
    )
    np.testing.assert_allclose(read, expected, rtol=1e-12)
    assert imported_recording.metadata["voltage"] == ("signed" if phase != 1.0 else "magnitude")
    assert f"array {name}" in imported_recording.metadata["source"]
    assert (
        f"{3 * n} numbers a frame at driven" in imported_recording.metadata["source"]
    ) == with_driven
    assert check.check(imported_recording).ok


def test_the_reference_is_read_and_what_has_objects_is_left_out(tmp_path):
    path = tmp_path / "tank.mat"
    vh, vi = frames(count=2), 1.2 * frames(count=3)
    scipy.io.savemat(path, {"vh": vh, "vi": {"meas": vi, "time": 0.0}, "fmdl": {"nodes": vi}})
    imported_recording = importers.load(path)
    np.testing.assert_array_equal(imported_recording.voltage, vh.T)
    assert "vi.meas left out, objects at unknown places" in imported_recording.metadata["source"]
    scipy.io.savemat(path, {"a": vh, "b": vi})
    refused(path, r"a \(208, 2\), b \(208, 3\), expected one whose name says that it is the ref")
    np.testing.assert_array_equal(importers.load(path, array="b").voltage, vi.T)
    scipy.io.savemat(path, {"vh": vh, "v_homg": vi, "other": vi})
    refused(path, r"found v_homg \(208, 3\), vh \(208, 2\)|found vh \(208, 2\), v_homg \(208, 3\)")
    scipy.io.savemat(path, {"vi": vi})
    assert "taken for untouched" in importers.load(path).metadata["source"]


def test_readings_of_structure_arrays_and_cells(tmp_path):
    path = tmp_path / "tank.mat"
    cells = np.empty((1, 2), dtype=object)
    cells[0, 0], cells[0, 1] = frames(), np.array(["words"])
    scipy.io.savemat(path, {"data": cells, "meas_select": np.ones((256, 1), dtype=bool)})
    assert "array data(1)" in importers.load(path).metadata["source"]


def test_both_signs_are_read_and_the_wrong_one_noticed(tmp_path):
    path = tmp_path / "tank.mat"
    cases = ((-1, None, "adjacent"), (PHASE, "adjacent", "adjacent-reversed"))
    for sign, measure, sign_of_measure in cases:
        scipy.io.savemat(path, {"vh": sign * frames()})
        (finding,) = check.check(importers.load(path, measure=measure)).of_topic("polarity")
        assert finding.severity == check.ERROR
        assert finding.sentence.endswith(f"--measure {sign_of_measure}.")
        imported_recording = importers.load(path, measure=sign_of_measure)
        assert (
            imported_recording.metadata["voltage"] == "signed"
            and check.check(imported_recording).ok
        )
        turn = [0, 1, 2, 3] if sign_of_measure == "adjacent" else [0, 1, 3, 2]
        np.testing.assert_array_equal(imported_recording.channels, channel_table(16)[:, turn])


@pytest.mark.parametrize("with_driven", [True, False])
def test_frames_that_turn_with_the_drive(tmp_path, with_driven):
    """EIDORS's rotate_meas: named by the check, or at once where numbers at the drive move too."""
    path = tmp_path / "tank.mat"
    turning = "drive-plus-ascending-own"
    scipy.io.savemat(path, {"vh": frames(with_driven=with_driven, order=turning)})
    if with_driven:
        with pytest.raises(InputError, match=r"order: found .*expected --order ") as caught:
            importers.load(path)
        message = str(caught.value)
    else:
        (finding,) = check.check(importers.load(path)).of_topic("order")
        message = finding.sentence
    named = message.split("--order ")[1].split()[0]
    for order in (turning, named):
        imported_recording = importers.load(path, order=order)
        assert check.check(imported_recording).ok
        np.testing.assert_allclose(
            np.abs(readings(imported_recording.channels, 16)),
            imported_recording.voltage[0],
            rtol=1e-9,
        )


def test_other_pairs_are_named_by_the_caller(tmp_path):
    path = tmp_path / "skin.mat"
    table = channel_table(16, "opposite")
    scipy.io.savemat(path, {"v": readings(table, 16)[:, None]})
    refused(path, r"v \(192, 1\), expected one array of n \(n - 3\) or n n rows .*--drive")
    imported_recording = importers.load(path, drive="opposite", measure="adjacent")
    np.testing.assert_array_equal(imported_recording.channels, table)
    assert check.check(imported_recording).ok
    assert "as told: drive opposite, measure adjacent" in imported_recording.metadata["source"]
    refused(path, "'askew'.*adjacent, opposite or skip-<n>", drive="askew")


def test_matlab_files_that_cannot_be_read_say_why(tmp_path):
    path = tmp_path / "tank.mat"
    scipy.io.savemat(path, {"vh": frames(count=50)}, do_compression=True)
    complete_bytes = path.read_bytes()
    for size in (130, 300, len(complete_bytes) // 2, len(complete_bytes) - 20):
        path.write_bytes(complete_bytes[:size])
        refused(path, "a damaged or cut MATLAB file, expected MATLAB 7.2 or before")
    for head in (b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(512), b"\x89HDF\r\n\x1a\n"):
        path.write_bytes(head + bytes(600))
        refused(path, "found MATLAB 7.3 or another HDF5 file, expected .*-v7")
    path.write_bytes(b"vh = [1 2 3]\n")
    refused(path, "no MATLAB file")
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(128, b"\xff") + b"\xff" * 64)
    refused(path, "a damaged or cut MATLAB file")
    scipy.io.savemat(path, {"words": "none", "small": np.ones((3, 3))})
    refused(path, r"found small \(3, 3\), expected one array")
    scipy.io.savemat(path, {"vh": np.full((208, 2), np.inf)})
    refused(path, "found inf in channel 0")


# --- the Kuopio Tomography Challenge


def challenge(factor=1.0):
    """ref.mat as the organisers made it: neighbours among the even electrodes, then against four of
    them; the reading of injection k, pair j is `factor` U of an even tank."""
    even = np.arange(0, 32, 2)
    drives = [(a, (a + 2) % 32) for a in even]
    drives += [(a, b) for b in (0, 8, 16, 24) for a in even if a != b]
    amplitudes = np.random.default_rng(0).normal(1.48, 0.02, len(drives))
    currents = np.zeros((32, len(drives)))
    for k, (source, sink) in enumerate(drives):
        currents[[source, sink], k] = amplitudes[k], -amplitudes[k]
    measured = np.zeros((32, 31))
    measured[np.arange(31), np.arange(31)], measured[np.arange(1, 32), np.arange(31)] = 1, -1
    channels = np.array([[*drive, j, j + 1] for drive in drives for j in range(31)])
    voltages = readings(channels, 32) * np.repeat(amplitudes, 31)
    return currents, measured, factor * voltages[:, None], channels


def test_the_reference_of_the_challenge(tmp_path):
    path = tmp_path / "ref.mat"
    currents, measured, voltages, channels = challenge()
    assert currents.shape == (32, 76) and voltages.shape == (2356, 1)
    ours = {"Injref": currents, "Mpat": measured, "Uelref": voltages}
    for reference in (voltages, voltages.reshape(76, 31).T, np.hstack([voltages, voltages])):
        scipy.io.savemat(path, ours | {"Uelref": reference, "Uel": 2 * voltages})
        imported_recording = importers.load(path)
        free = np.array([not set(row[:2]) & set(row[2:]) for row in channels.tolist()])
        np.testing.assert_array_equal(imported_recording.channels, channels[free])
        np.testing.assert_allclose(
            imported_recording.voltage[0], readings(channels, 32)[free], rtol=1e-9
        )
        assert not imported_recording.frames["touch"].any() and check.check(imported_recording).ok
        assert "Uel left out" in imported_recording.metadata["source"]
        assert (
            f"{np.sum(~free)} readings at driven electrodes"
            in imported_recording.metadata["source"]
        )
    scipy.io.savemat(path, ours | {"Uelref": -voltages})
    assert check.check(importers.load(path)).of_topic("polarity")
    refused(path, "setting measure: .*ktc-mat states its own", measure="adjacent")


def test_what_does_not_fit_together_in_the_challenge_is_refused(tmp_path):
    path = tmp_path / "data1.mat"
    currents, measured, voltages, _ = challenge()
    complete_arrays = {"Inj": currents, "Mpat": measured, "Uelref": voltages}
    for changed, match in (
        ({"Uelref": voltages[:-1]}, r"found \(2355, 1\), expected 2356 rows"),
        ({"Uelref": voltages * 1j}, "complex numbers"),
        ({"Mpat": measured[:31]}, "32 electrodes in Inj, 31 in Mpat"),
        ({"Mpat": np.abs(measured)}, "Mpat, column 0: found 2 electrodes"),
        ({"Inj": np.eye(32)}, "Inj, column 0: found 1 electrodes"),
        ({"Inj": np.ones((32, 76))}, "Inj, column 0: found 32 electrodes"),
    ):
        scipy.io.savemat(path, complete_arrays | changed)
        refused(path, match)
    scipy.io.savemat(path, {"Inj": currents, "Mpat": measured, "Uel": voltages})
    refused(path, "Uel alone: objects at places that nobody wrote down, expected Uelref")


def model_of(rim, electrodes):
    """A forward model with nodes on a rim (K, 2) and inside it, and electrodes at (n, 2)."""
    nodes = np.concatenate([rim, 0.5 * (rim + rim.mean(axis=0)), electrodes])
    first_index = len(nodes) - len(electrodes) + 1
    electrode_structs = np.zeros(
        (1, len(electrodes)), dtype=[("nodes", object), ("z_contact", object)]
    )
    for k in range(len(electrodes)):
        electrode_structs[0, k] = np.array([[first_index + k]]), 0.01
    return {"nodes": nodes, "electrode": electrode_structs}


def around(count, radius=1.0):
    angle = 2.0 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize(
    ("rim", "electrodes", "outline_text"),
    [
        (around(48), around(16), None),
        (around(48) * [1.0, 0.6], around(16) * [1.0, 0.6], "an outline of"),
        (
            np.array([[0, 0], [2, 0], [2, 1], [0, 1.0]]),
            around(16, 0.1) + np.array([1, 0.5]),
            "a rectangle",
        ),
        (around(48) + 5.0, around(16, 0.5) + 5.0, "electrode 0 and 15 more of 16 off the rim"),
    ],
)
def test_a_forward_model_tells_what_the_outline_is(tmp_path, rim, electrodes, outline_text):
    path = tmp_path / "tank.mat"
    scipy.io.savemat(path, {"vh": frames(), "fmdl": model_of(rim, electrodes)})
    outline = importers.load(path).skin.outline
    assert outline is None if outline_text is None else outline.startswith(outline_text)
