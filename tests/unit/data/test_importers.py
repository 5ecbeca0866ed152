"""Every format from a small file written here, and from the publishers' files where they are."""

import re
import sys
import zipfile

import numpy as np
import pandas as pd
import pytest
import scipy.io

from eitskin.data import check, importers, recording
from eitskin.data.alignment import homogeneous_readings
from eitskin.data.check import sentences
from eitskin.data.importers import lct_tank, pyeidors_tank
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from eitskin.pins import ROOT
from shared_data import shared_data


def refused(path, match, format=None):
    with pytest.raises(InputError, match=match) as caught:
        importers.load(path, format)
    assert "\n" not in str(caught.value)


def reciprocity(path):
    finding = sentences.reciprocity(importers.load(path))
    return finding[0].value


def tank_reading(channels):
    """A reading in the order and polarity of `channels`, with a made-up phase."""
    reading = homogeneous_readings(np.asarray(channels), 22.5 * np.arange(16))
    return reading * np.exp(0.1j)


def likeness(imported_recording):
    """Correlation of the in-phase readings with a homogeneous disc's, by the channel table."""
    model = homogeneous_readings(
        imported_recording.channels, np.array(imported_recording.skin.electrode_deg)
    )
    return np.corrcoef(model, imported_recording.voltage[0])[0, 1]


# --- any file


def test_an_unknown_file_is_refused_with_the_known_formats(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("nothing of the kind\n")
    refused(
        path,
        "found text that begins 'nothing of the kind', expected one of eit-recording, matrix, lo",
    )
    refused(tmp_path, "one of eit-recording")
    refused(tmp_path / "absent", "no such file")
    refused(path, "format: found 'csv', expected one of", "csv")
    path.write_bytes(bytes(range(256)))
    refused(path, "one of eit-recording")


FOREIGN = {
    "rec.xls": (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "an Excel workbook of before 2007"),
    "rec.csv.gz": (b"\x1f\x8b\x08\x00", "packed by gzip, expected it unpacked"),
    "rec.bin": (bytes(range(128, 256)) * 40, "PulmoVista .* expected a .mat of it"),
    "rec.eit": (
        b"---Draeger EIT-Software---\r\nFormat: 51\r\n**\r\n" + bytes(range(256)),
        "Draeger's binary .eit, which is not read, expected a .get, or a .mat",
    ),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_a_file_of_another_program_is_named(tmp_path, name):
    content, match = FOREIGN[name]
    (tmp_path / name).write_bytes(content)
    refused(tmp_path / name, match)


def test_a_workbook_of_excel_is_named_or_read(tmp_path, monkeypatch):
    path = tmp_path / "rec.xlsx"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("xl/workbook.xml", "")
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "openpyxl", None)
        refused(path, "an Excel workbook, expected the sheet saved as CSV; or openpyxl installed")
    refused(path, "a damaged Excel workbook")
    columns = [f"v{k}" for k in range(40)]
    pd.DataFrame(np.outer([1, 2], tank_reading(channel_table(8))), columns=columns).to_excel(
        path, index=False
    )
    path.with_suffix(".yaml").write_text("{drive: adjacent, measurement: adjacent}")
    assert importers.load(path).voltage.shape == (2, 40)


def test_a_recording_of_our_own_is_read(make_recording, tmp_path):
    path = tmp_path / "skin.parquet"
    recording.write(make_recording(), path)
    for format in (None, "eit-recording"):
        assert importers.load(path, format).metadata["source"] == "simulation"
    path.write_bytes(path.read_bytes()[:-100])
    refused(path, "an end cut off")


def mat(path, **arrays):
    scipy.io.savemat(path, arrays)


ODD_FILES = {
    "binary.csv": lambda path: path.write_bytes(bytes(range(256)) * 50),
    "inp_binary.csv": lambda path: (
        path.write_bytes(b"1,2\n\xff\xfe"),
        path.with_name("out_binary.csv").write_bytes(b"1,2,3\n"),
    ),
    "late_binary.csv": lambda path: path.write_bytes(b"1,2,3,4\n" * 5000 + b"\xff\xff\n"),
    "empty": lambda path: path.touch(),
    "inp_empty.csv": lambda path: (path.touch(), path.with_name("out_empty.csv").touch()),
    "text.txt": lambda path: path.write_text("nothing\nof the kind\n"),
    "lct.txt": lambda path: path.write_text("#MEAS\n#Date\n#Start\n1 2 3\n"),
    "logger.csv": lambda path: path.write_text("contact_idx,force_n,t_eit,eit_0\n"),
    "folder": lambda path: path.mkdir(),
    "inp_folder.csv": lambda path: (path.mkdir(), path.with_name("out_folder.csv").mkdir()),
    "folder_of_folders": lambda path: (path / "water_1.txt").mkdir(parents=True),
    "folder_of_binaries": lambda path: (
        path.mkdir(),
        (path / "a.txt").write_bytes(bytes(range(256))),
    ),
    "words.mat": lambda path: mat(
        path,
        positions=["a"],
        responseups=["b"],
        responsedowns=["c"],
        v_reference=np.array(["d"] * 256)[:, None],
        v_rotate=["e"],
    ),
    "cells.mat": lambda path: mat(
        path,
        positions={"a": 1},
        responseups=np.array([1, "x"], dtype=object),
        responsedowns={},
        v_reference=np.array([["cell"], [1.0]] * 128, dtype=object),
        v_rotate=1.0,
    ),
    "nothing.mat": lambda path: mat(
        path,
        positions=np.zeros((0, 3)),
        responseups=np.zeros((0, 0)),
        responsedowns=np.zeros((0, 0)),
        v_reference=np.zeros((0, 0)),
        v_rotate=np.zeros((0, 0)),
    ),
    "parquet": lambda path: path.write_bytes(b"PAR1PAR1"),
}


@pytest.mark.parametrize("name", ODD_FILES)
@pytest.mark.parametrize("format", [None, *importers.format_names()])
def test_an_odd_file_is_refused_in_one_line_by_every_format(tmp_path, name, format):
    path = tmp_path / name
    ODD_FILES[name](path)
    refused(path, f"{tmp_path}.*: found .*, expected ", format)


def test_an_odd_file_is_refused_in_one_line_by_the_tutorial_s_importer(tmp_path, monkeypatch):
    page = (ROOT / "docs" / "tutorials" / "a_new_board.md").read_text(encoding="utf-8")
    module = re.search(r"^# workflow/\S+/bench_8.py\n(.*?)^```", page, re.DOTALL | re.MULTILINE)[1]
    (tmp_path / "bench_8.py").write_text(module, encoding="utf-8")
    monkeypatch.setattr(importers, "__path__", [*importers.__path__, str(tmp_path)])
    monkeypatch.setattr(importers, "FORMATS", (*importers.FORMATS, "bench-8"))
    for name, make in ODD_FILES.items():
        path = tmp_path / f"of {name}" / name
        path.parent.mkdir()
        make(path)
        refused(path, f"{tmp_path}.*: found .*, expected ", "bench-8")
    del sys.modules["eitskin.data.importers.bench_8"]


# --- the paper's logger


def logger_rows(forces, **changes):
    """Rows of the logger's CSV; reading (drive k, pair j) is 0.01 (16 k + j) V."""
    channels = channel_table(16)
    readings = np.zeros(256)
    live = 16 * channels[:, 0] + channels[:, 2]
    readings[live] = 0.01 * live
    rows = [
        {
            "t": f"2025-07-31 10:00:{k:02d}.0",
            **dict.fromkeys(["tcp_x", "tcp_y", "tcp_z", "tcp_rx", "tcp_ry", "tcp_rz"], 0.1),
            "contact_idx": 3,
            "contact_u_m": 0.02,
            "contact_v_m": -0.03,
            "contact_r_norm": 0.4,
            "contact_theta": 1.0,
            "depth_m": 0.001 * (k + 1),
            "force_n": force,
            "t_eit": 5000.0 + 3.5 * k,
            **{f"eit_{index}": value for index, value in enumerate(readings)},
        }
        for k, force in enumerate(forces)
    ]
    for name, values in changes.items():
        for row, value in zip(rows, values, strict=True):
            row[name] = value
    return pd.DataFrame(rows)


@pytest.fixture
def logger(tmp_path):
    def write(forces, **changes):
        path = tmp_path / "press_polar_steps.csv"
        logger_rows(forces, **changes).to_csv(path, index=False)
        return path

    return write


def test_the_logger_keeps_untouched_and_touched_rows(logger):
    path = logger([-0.001, 0.049, 0.05, 0.499, 0.5, 8.2, None])
    imported_recording = importers.load(path)
    assert imported_recording.frames["touch"].tolist() == [False, False, True, True]
    assert imported_recording.frames["force_N"].tolist() == [0.0, 0.0, 0.5, 8.2]
    assert imported_recording.frames["time_s"].tolist() == [0.0, 3.5, 14.0, 17.5]
    np.testing.assert_allclose(imported_recording.frames["depth_mm"], [np.nan, np.nan, 5.0, 6.0])
    np.testing.assert_allclose(imported_recording.frames["x_mm"][2:], 20.0)
    np.testing.assert_allclose(imported_recording.frames["y_mm"][2:], -30.0)
    assert recording.presses(imported_recording).tolist() == [-1, -1, 0, 0]
    assert (
        "2 rows between 0.05 N and 0.5 N, 1 without a force or a frame"
        in imported_recording.metadata["source"]
    )
    assert (
        imported_recording.metadata["position_frame"] == "robot"
        and imported_recording.metadata["voltage"] == "magnitude"
    )


def test_the_loggers_channels_are_picked_by_index_even_where_a_reading_is_zero(logger):
    channels = channel_table(16)
    live = 16 * channels[:, 0] + channels[:, 2]
    imported_recording = importers.load(logger([0.0, 1.0], eit_2=[0.0, 0.0]))
    expected = 0.01 * live
    expected[live == 2] = 0.0
    np.testing.assert_allclose(imported_recording.voltage, [expected, expected])
    np.testing.assert_array_equal(imported_recording.channels, channels)


def test_the_loggers_driven_pairs_must_be_constant_but_need_not_be_zero(logger):
    assert importers.load(logger([0.0, 1.0], eit_0=[0.3, 0.3])).voltage.shape == (2, 208)
    refused(logger([0.0, 1.0], eit_17=[0.0, 0.2]), "line 3, column eit_17: .*touches drive 1")


def test_what_the_logger_lost_is_lost_or_left_out(logger):
    nothing = {f"eit_{index}": [0.0, None, 0.0] for index in range(256)}
    imported_recording = importers.load(logger([0.0, 1.0, 1.0], **nothing, t_eit=[1.0, None, 2.0]))
    assert (
        len(imported_recording.frames) == 2
        and "1 without a force or a frame" in imported_recording.metadata["source"]
    )
    imported_recording = importers.load(logger([0.0, 1.0], eit_2=[0.1, None]))
    assert np.isnan(imported_recording.voltage).sum() == 1


def test_the_logger_s_line_is_the_file_s(logger):
    path = logger([0.0, 1.0], eit_0=[None, 0.3], eit_9=["0.1", "0.1.2"])
    path.write_text(path.read_text().replace("\n", "\n\n \n", 1))
    refused(path, "line 5, column eit_9: found '0.1.2'")
    path = logger([0.0, 1.0, 1.0], eit_0=[None, 0.3, 0.2])
    refused(path, r"line 4, column eit_0: found 0.2, expected 0.3 throughout")
    path = logger([0.0, 1.0], t=["a\nday", "b"])
    refused(path, "file: found a row of several lines")


def test_a_bad_logger_file_is_refused(logger):
    refused(logger([0.0, 1.0, 1.0], t_eit=[9.0, 8.0, 10.0]), "line 3, column t_eit: found 8.0")
    refused(logger([0.0, 0.2, 0.3, 1.0], t_eit=[9.0, 9.5, 9.7, 3.0]), "line 5, column t_eit")
    refused(logger([0.0, 1.0], eit_9=["0.1", "0.1.2"]), "line 3, column eit_9: found '0.1.2'")
    refused(logger([0.1, 0.2]), "rows: found none of use")
    refused(logger([1.0, 2.0]), "untouched frame among absolute values")
    path = logger([0.0, 1.0])
    pd.read_csv(path).drop(columns="eit_255").to_csv(path, index=False)
    refused(path, "column eit_255: found nothing")
    path.write_text("contact_idx,force_n,t_eit,eit_0\n1,2\n3,4,5,6,7,8\n")
    refused(path, "expected the logger's CSV")


# --- the hydrogel skin


@pytest.mark.parametrize("n", [16, 8])
def test_the_hydrogel_skin_is_untouched_then_pressed(tmp_path, n):
    path = tmp_path / "ohmc.mat"
    width = n * (n - 4)
    ups = 1.0 + np.arange(3 * width, dtype=float).reshape(3, width)
    positions = np.array([[0.01, 0.02, 0.01], [-0.03, 0.0, 0.015], [0.0, -0.05, 0.02]])
    scipy.io.savemat(
        path, {"positions": positions, "responseups": ups, "responsedowns": 1000.0 + ups}
    )
    imported_recording = importers.load(path)
    assert imported_recording.frames["touch"].tolist() == [False, True] * 3
    np.testing.assert_array_equal(imported_recording.voltage[::2], ups)
    np.testing.assert_array_equal(imported_recording.voltage[1::2], 1000.0 + ups)
    np.testing.assert_allclose(
        imported_recording.frames[["x_mm", "y_mm", "depth_mm"]][1::2], 1e3 * positions
    )
    assert imported_recording.frames["force_N"].isna().tolist() == [False, True] * 3
    assert recording.presses(imported_recording).tolist() == [-1, 0, -1, 1, -1, 2]
    assert (
        imported_recording.metadata["clock"] == "index"
        and imported_recording.skin.radius_mm == 85.5
    )
    electrode = np.exp(1j * np.deg2rad(imported_recording.skin.electrode_deg))
    np.testing.assert_allclose(electrode[0], -1j, atol=1e-12)
    assert electrode[1].real > 0 and electrode[n // 4].real == pytest.approx(1.0)


def test_a_hydrogel_file_that_does_not_fit_together_is_refused(tmp_path):
    path = tmp_path / "ohmc.mat"
    complete_arrays = {"positions": np.zeros((2, 3)), "responseups": np.ones((2, 192))}
    for downs, message in ((np.ones((3, 192)), "pressed"), (np.ones((2, 190)), "pressed")):
        scipy.io.savemat(path, complete_arrays | {"responsedowns": downs})
        refused(path, message)
    ups = {"responseups": np.ones((2, 30)), "responsedowns": np.ones((2, 30))}
    scipy.io.savemat(path, complete_arrays | ups)
    refused(path, "30 channels")
    scipy.io.savemat(
        path, complete_arrays | {"positions": np.zeros((2, 2)), "responsedowns": np.ones((2, 192))}
    )
    refused(path, "x, y, depth a press")
    path.write_bytes(path.read_bytes()[:300])
    refused(path, "a damaged or cut MATLAB file")


def test_real_hydrogel_skins(tmp_path):
    for name, n in (("ohmc16", 16), ("ohmc8", 8)):
        imported_recording = importers.load(shared_data(f"hydrogel-skin/{name}.mat"))
        assert (
            imported_recording.voltage.shape == (1000, n * (n - 4))
            and imported_recording.frames["touch"].sum() == 500
        )
        assert set(imported_recording.frames["depth_mm"].dropna()) == {10.0, 15.0, 20.0}
        recording.write(imported_recording, tmp_path / f"{name}.parquet")
    lookup = scipy.io.loadmat(shared_data("hydrogel-skin/lookup192.mat"))["lookup"]
    imported_recording = importers.load(shared_data("hydrogel-skin/ohmc16.mat"))
    np.testing.assert_array_equal(imported_recording.channels, lookup // 2)


# --- the tanks


def test_the_iirc_tank(tmp_path):
    path = tmp_path / "iirc.mat"
    all_channels = [(k, (k + 1) % 16, j, (j + 1) % 16) for k in range(16) for j in range(16)]
    reference = np.nan_to_num(tank_reading(all_channels), nan=7.0)[:, None]
    scipy.io.savemat(path, {"v_reference": reference, "v_rotate": np.ones((256, 5)) * 1j})
    imported_recording = importers.load(path)
    assert (
        imported_recording.voltage.shape == (1, 208)
        and not imported_recording.frames["touch"].any()
    )
    expected = tank_reading(channel_table(16))
    np.testing.assert_allclose(
        imported_recording.voltage[0] + 1j * imported_recording.quadrature[0], expected
    )
    assert "5 frames with a rod" in imported_recording.metadata["source"]
    assert likeness(imported_recording) == pytest.approx(1.0)
    scipy.io.savemat(path, {"v_reference": reference[:208], "v_rotate": np.ones((256, 5))})
    refused(path, r"v_reference: found \(208, 1\)")


def test_the_real_iirc_tank():
    path = shared_data("iirc-tank/iirc_data_2006.mat")
    imported_recording = importers.load(path)
    assert reciprocity(path) == pytest.approx(0.048, abs=0.001)
    assert likeness(imported_recording) > 0.99, "current enters at the source"
    assert (
        imported_recording.skin.radius_mm == 100.0
        and imported_recording.skin.electrode_width_mm == 10.0
    )


def pyeidors_lines(reading):
    target = 2.0 * reading
    table = np.column_stack([reading.real, reading.imag, target.real, target.imag])
    return "".join(",".join(map(repr, row)) + "\n" for row in table.tolist())


def test_the_pyeidors_tank(tmp_path):
    path = tmp_path / "tank.csv"
    order = [
        (k, (k + 1) % 16, (k + 3 + i) % 16, (k + 2 + i) % 16) for k in range(16) for i in range(13)
    ]
    reading = tank_reading(order)
    path.write_text(pyeidors_lines(reading))
    imported_recording = importers.load(path)
    assert imported_recording.channels.tolist() == [list(row) for row in order]
    np.testing.assert_allclose(
        imported_recording.voltage[0] + 1j * imported_recording.quadrature[0], reading
    )
    assert (
        "target frame, objects at unknown places, left out" in imported_recording.metadata["source"]
    )
    assert check.check(imported_recording).ok
    path.write_text(pyeidors_lines(reading[:-1]))
    refused(path, "rows: found 207, expected 208")
    path.write_text("1.5,2,3,4\n1,2,x,4\n")
    refused(path, "line 2, column 2: found 'x', expected a number")
    path.write_text("1.5,2,3,4\n1,2,3\n")
    refused(path, "line 2: found 3 cells, expected 4")


def test_real_pyeidors_tanks():
    latest = shared_data("pyeidors-tank/measurements/tank/2026-03-14_latest_tank_data")
    files = sorted(latest.glob("*/*.csv"))
    assert len(files) == 6
    errors = [reciprocity(path) for path in files]
    assert min(errors) >= 0.014 and max(errors) <= 0.024
    assert all(likeness(importers.load(path)) > 0.99 for path in files)


def lct_text(reading, date="16/07/2004 16:25:38", rows=209):
    table = np.column_stack([reading.real, reading.imag, np.full(len(reading), 3e-4)])
    table = np.vstack([table, table[-1:]])[:rows]
    numbers = "".join(" ".join(map(repr, row)) + " \n" for row in table.tolist())
    return f"#MEAS   \n#Length, 208\n#Date {date}   \n#Start   \n{numbers}"


def test_the_lct_tank_and_its_repeats(tmp_path):
    order = channel_table(16)[:, [0, 1, 3, 2]]
    reading = tank_reading(order)
    for k, second in ((1, "57"), (2, "38")):
        (tmp_path / f"water_{k}.txt").write_text(
            lct_text(k * reading, f"16/07/2004 16:25:{second}")
        )
    single_recording = importers.load(tmp_path / "water_1.txt")
    np.testing.assert_array_equal(single_recording.channels, order)
    np.testing.assert_allclose(
        single_recording.voltage[0] + 1j * single_recording.quadrature[0], reading
    )
    both_recordings = importers.load(tmp_path)
    np.testing.assert_allclose(both_recordings.voltage, [2 * reading.real, reading.real])
    assert both_recordings.frames["time_s"].tolist() == [0.0, 19.0]
    (tmp_path / "metal_1.txt").write_text(lct_text(reading))
    refused(tmp_path, r"states \['metal', 'water'\]")
    path = tmp_path / "metal_1.txt"
    path.write_text(lct_text(reading, rows=208))
    refused(path, "rows after #Start: found 208, expected 209")
    path.write_text(lct_text(reading, date="yesterday"))
    refused(path, "#Date: found yesterday")
    undated = lct_text(reading).replace("#Date", "#Data")
    path.write_text(undated)
    assert importers.load(path).metadata["clock"] == "index"
    path.unlink()
    (tmp_path / "water_2.txt").write_text(undated)
    refused(tmp_path, r"water_2\.txt: header, #Date: found none")
    path.write_text("#MEAS\n1 2 3\n")
    refused(path, "no line #Start")


def test_real_lct_tanks():
    folder = shared_data("lct-tank/homogeneous")
    errors = [reciprocity(path) for path in sorted(folder.glob("*.txt"))]
    assert errors == pytest.approx([0.015] * 3, abs=0.002)
    imported_recording = importers.load(folder)
    assert len(imported_recording.frames) == 3 and imported_recording.frames["time_s"].tolist() == [
        0.0,
        19.0,
        34.0,
    ]
    assert likeness(imported_recording) > 0.99


# --- the patterned skin


def test_the_patterned_skin_is_a_pair_of_files(tmp_path):
    width = len(channel_table(16, "opposite"))
    inp_path, out_path = tmp_path / "inp_a.csv", tmp_path / "out_a.csv"
    values = np.arange(2.0 * width).reshape(2, width) - 5.0
    inp_path.write_text(
        "".join(",".join(map(str, row)) + "\n" for row in values), encoding="utf-8-sig"
    )
    out_path.write_text("0.01,-0.4,0.019\n0.02,-0.41,0.018\n", encoding="utf-8-sig")
    for path in (inp_path, out_path):
        imported_recording = importers.load(path)
        np.testing.assert_array_equal(imported_recording.voltage, values)
        np.testing.assert_allclose(
            imported_recording.frames[["x_mm", "y_mm"]], [[10, -400], [20, -410]]
        )
        np.testing.assert_allclose(imported_recording.frames["note_robot_z_mm"], [19.0, 18.0])
    assert (
        imported_recording.metadata["values"] == "difference"
        and imported_recording.frames["touch"].all()
    )
    assert imported_recording.frames[["force_N", "depth_mm", "probe_mm"]].isna().all().all()
    out_path.write_text("0.01,-0.4,0.019\n")
    refused(inp_path, "rows: found 1, expected 2 as in inp_a.csv")
    out_path.unlink()
    refused(inp_path, "no such file, expected the partner of inp_a.csv", "patterned-skin")
    refused(inp_path, r"no inp_a\.yaml")


def test_the_real_patterned_skin(tmp_path):
    imported_recording = importers.load(shared_data("patterned-skin/inp_noPattern.csv"))
    assert imported_recording.voltage.shape == (2500, 192)
    recording.write(imported_recording, tmp_path / "patterned.parquet")
    assert recording.read(tmp_path / "patterned.parquet").metadata == imported_recording.metadata


# --- a wrong order shows at once


@pytest.mark.parametrize(
    ("name", "module"),
    [
        ("pyeidors-tank/measurements/tank/2026-03-14_latest_tank_data", pyeidors_tank),
        ("lct-tank/homogeneous", lct_tank),
    ],
)
def test_the_tanks_in_each_others_order_break_reciprocity(name, module):
    files = [*shared_data(name).rglob("*.csv"), *shared_data(name).rglob("*.txt")]
    for path in files:
        imported_recording = module.load(path)
        other_path = pyeidors_tank if module is lct_tank else lct_tank
        table = (
            pyeidors_tank.channels_from_drive()
            if other_path is pyeidors_tank
            else channel_table(16)
        )
        imported_recording.metadata["channels"] = table[:, [0, 1, 3, 2]].tolist()
        order = check.check(imported_recording).of_topic("order")
        assert 0.6 < order[0].value < 1.1
        assert [finding.severity for finding in order] == [check.ERROR]
        assert "wrong channel order" in order[0].sentence


def test_what_is_read_is_told_before_it_is_read(tmp_path):
    pair = [tmp_path / f"{name}_noPattern.csv" for name in ("inp", "out")]
    for path in pair:
        path.write_text("0\n")
    frames = tmp_path / "water"
    frames.mkdir()
    for k in (1, 2):
        (frames / f"water_{k}.txt").write_text("#MEAS\n")
    assert importers.files(pair[0], "patterned-skin") == pair
    assert importers.files(frames) == [frames, *sorted(frames.iterdir())]
    for other_path in (tmp_path / "absent.parquet", pair[0].with_name("text.md")):
        assert importers.files(other_path) == [other_path]
        assert importers.readers(other_path) == []
    assert importers.readers(frames) == ["eitskin.data.importers.lct_tank"]
    assert importers.readers(pair[0], "patterned-skin") == ["eitskin.data.importers.patterned_skin"]
