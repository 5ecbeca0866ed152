"""Sciospec's .eit from samples written here: potentials of an even skin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.data import check, importers
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from homogeneous_skin import PHASE, potentials, readings

LISTS = (
    "MeasurementChannels: {setup}",
    "MeasurementChannelsIndependentFromInjectionPattern: {read}",
)


def eit_text(
    drives,
    n=16,
    second=0.0,
    frequencies=1,
    lines=18,
    columns=None,
    setup=None,
    amplitude=0.001,
    mode=1,
):
    """A file as Sciospec writes it; the k-th frequency has k times the potentials. Electrodes
    without a part in the ring (`columns` beyond n) read 7 V."""
    columns = columns or list(range(1, n + 1))
    setup = setup or list(range(1, n + 1))
    values = ["1000", f"{1000 * frequencies}", "0", str(frequencies), str(amplitude), "10"]
    header = ["skin", f"2023.01.05. 14:36:{10 + second:06.3f}", *values]
    if lines >= 11:
        header = ["2", *header, "0"]
    if lines == 18:
        header += ["1", "5", str(mode), "0", "1"]
        header += [
            LISTS[0].format(setup=",".join(map(str, setup))),
            LISTS[1].format(read=",".join(map(str, columns))),
        ]
    text = [str(lines), *header]
    assert len(text) == lines
    for source, sink in drives:
        text.append(f"{source} {sink}")
        potential_of = dict(
            zip(setup, potentials((setup.index(source), setup.index(sink)), n), strict=True)
        )
        for k in range(frequencies):
            row = [amplitude * (k + 1) * potential_of.get(column, 7.0) for column in columns]
            text.append("\t".join(f"{u.real:.12E}\t{u.imag:.12E}" for u in row))
    return "\n".join(text) + "\n"


def around(n=16, step=1):
    return [(k + 1, (k + step) % n + 1) for k in range(n)]


def refused(path, match):
    with pytest.raises(InputError, match=match) as caught:
        importers.load(path)
    assert "\n" not in str(caught.value)


@settings(max_examples=12, deadline=None)
@given(
    n=st.sampled_from([8, 16]),
    step=st.sampled_from([1, 3]),
    measure=st.sampled_from([None, "adjacent", "skip-1", "adjacent-reversed"]),
    lines=st.sampled_from([9, 11, 18]),
    frequencies=st.sampled_from([1, 3]),
)
def test_differences_are_made_of_potentials(tmp_path_factory, n, step, measure, lines, frequencies):
    path = tmp_path_factory.mktemp("eit") / "setup_00001.eit"
    path.write_text(eit_text(around(n, step), n, lines=lines, frequencies=frequencies))
    imported_recording = importers.load(path, measure=measure)
    assert (
        imported_recording.n_electrodes == n
        and imported_recording.metadata["unit"] == "V"
        and imported_recording.skin.current_A == 1e-3
    )
    base = (measure or "adjacent").removesuffix("-reversed")
    expected = channel_table(n, "adjacent" if step == 1 else f"skip-{step - 1}", base)
    turned = [0, 1, 3, 2] if measure and measure.endswith("-reversed") else [0, 1, 2, 3]
    np.testing.assert_array_equal(imported_recording.channels, expected[:, turned])
    model = 1e-3 * PHASE * readings(imported_recording.channels, n)
    np.testing.assert_allclose(
        imported_recording.voltage[0] + 1j * imported_recording.quadrature[0], model, rtol=1e-7
    )
    assert check.check(imported_recording).ok
    assert ("3 frequencies" in imported_recording.metadata["source"]) == (frequencies == 3)
    assert "differences of potentials made" in imported_recording.metadata["source"]


def test_a_folder_is_frames_in_the_order_of_their_numbers(tmp_path):
    for k, second in ((1, 0.0), (2, 0.11), (10, 0.19)):
        text = eit_text(around(), second=second)
        (tmp_path / f"setup_{k}.eit").write_text(text)
    imported_recording = importers.load(tmp_path)
    np.testing.assert_allclose(imported_recording.frames["time_s"], [0.0, 0.11, 0.19])
    assert (
        imported_recording.metadata["clock"] == "measured"
        and not imported_recording.frames["touch"].any()
    )
    frame_files = importers.files(tmp_path)
    assert [file.name for file in frame_files[1:]] == ["setup_1.eit", "setup_2.eit", "setup_10.eit"]
    (tmp_path / "setup_10.eit").rename(tmp_path / "SETUP_10.EIT")
    assert len(importers.load(tmp_path).frames) == 3
    assert len(importers.load(tmp_path / "SETUP_10.EIT").frames) == 1
    (tmp_path / "SETUP_10.EIT").rename(tmp_path / "setup_10.eit")
    (tmp_path / "setup_11.eit").write_text(eit_text(around(), second=0.19))
    refused(tmp_path, r"setup_11\.eit: header, date: .*one after that of setup_10\.eit")
    (tmp_path / "setup_11.eit").write_text(eit_text(around(step=3), second=0.3))
    refused(tmp_path, r"setup_11\.eit: setup: found another")


def test_the_setups_electrodes_among_all_that_are_read(tmp_path):
    path = tmp_path / "setup_00001.eit"
    setup = [1, 3, 5, 7, 9, 11, 13, 15]
    drives = [(setup[k], setup[(k + 1) % 8]) for k in range(8)]
    path.write_text(eit_text(drives, 8, columns=list(range(1, 17)), setup=setup))
    imported_recording = importers.load(path)
    np.testing.assert_array_equal(imported_recording.channels, channel_table(8))
    model = 1e-3 * PHASE * readings(imported_recording.channels, 8)
    np.testing.assert_allclose(
        imported_recording.voltage[0] + 1j * imported_recording.quadrature[0], model, rtol=1e-7
    )
    assert (
        "electrodes (1, 3, 5, 7, 9, 11, 13, 15) counted from 0"
        in imported_recording.metadata["source"]
    )
    assert check.check(imported_recording).ok


def test_source_and_sink_exchanged_are_noticed(tmp_path):
    path = tmp_path / "setup_00001.eit"
    lines = eit_text(around()).splitlines()
    lines[18::2] = [" ".join(reversed(line.split())) for line in lines[18::2]]
    path.write_text("\n".join(lines))
    assert check.check(importers.load(path)).of_topic("polarity")


def test_the_files_own_drives_are_not_named_anew(tmp_path):
    path = tmp_path / "setup_00001.eit"
    path.write_text(eit_text(around()))
    with pytest.raises(InputError, match=r"setting drive: .*sciospec-eit states its own"):
        importers.load(path, drive="adjacent")
    with pytest.raises(InputError, match="measure 'askew'"):
        importers.load(path, measure="askew")


MAX_MISFIT = {
    "cut within a line": (
        lambda text: text[: len(text) - 200],
        "numbers, expected 32, real and im",
    ),
    "cut after a line": (lambda text: "\n".join(text.splitlines()[:-1]), "31 lines after the hea"),
    "words": (lambda text: text.replace("E-", "x-", 40), "could not convert string to float"),
    "no injection": (lambda text: text.replace("\n3 4\n", "\nthree 4\n"), "found three 4"),
    "itself": (lambda text: text.replace("\n3 4\n", "\n4 4\n"), "two electrodes"),
    "off the ring": (lambda text: text.replace("\n3 4\n", "\n3 40\n"), "electrode 40, which none"),
    "date": (lambda text: text.replace("2023.01.05. ", "5 Jan "), "header, date"),
    "amplitude": (lambda text: text.replace("0.001", "low"), "header, amplitude"),
    "no frequency": (
        lambda text: text.replace("\n1\n0.001", "\n0\n0.001"),
        "number of frequencies",
    ),
    "header": (lambda text: "180" + text[2:], "line 1"),
    "differences": (lambda text: text.replace("\n5\n1\n", "\n5\n2\n"), "measure mode"),
    "no list": (lambda text: text.replace("1,2,3", "1,two,3"), "numbers of channels"),
}


@pytest.mark.parametrize("name", MAX_MISFIT)
def test_a_broken_file_is_refused(tmp_path, name):
    path = tmp_path / "setup_00001.eit"
    spoil, match = MAX_MISFIT[name]
    complete_text = eit_text(around())
    assert spoil(complete_text) != complete_text
    path.write_text(spoil(complete_text))
    refused(path, match)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "setup_00001.eit"
    path.write_bytes(eit_text(around()).encode() + b"\xff\xfe\xfa")
    refused(path, "found byte 0xff, no UTF-8, expected UTF-8")


def test_another_makers_file_is_told_apart(tmp_path):
    path = tmp_path / "breath.eit"
    path.write_bytes(b"\x33\x00\x00\x00**FileVersion 0" + bytes(300))
    refused(path, "no Sciospec .eit")


@pytest.mark.parametrize(("frequency", "factor"), [(None, 1), (2000.0, 2), (3000.0, 3)])
def test_one_of_several_frequencies_is_read(tmp_path, frequency, factor):
    path = tmp_path / "setup_00001.eit"
    path.write_text(eit_text(around(), frequencies=3))
    imported_recording = importers.load(path, frequency=frequency)
    expected = factor * 1e-3 * (PHASE * readings(channel_table(16), 16)).real
    np.testing.assert_allclose(imported_recording.voltage[0], expected, rtol=1e-9)
    assert f"{1000 * factor} Hz" in imported_recording.metadata["source"]
    with pytest.raises(InputError, match="found 1500 Hz, expected one of 1000, 2000, 3000 Hz"):
        importers.load(path, frequency=1500.0)
