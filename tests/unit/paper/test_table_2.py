import numpy as np
import pandas as pd
import pytest

from eitskin.data import recording
from eitskin.errors import InputError
from eitskin.paper import table_2
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.pins import ROOT
from eitskin.simulate.readings import simulate
from eitskin.simulate.untouched_frames import Plan

PAPER = ROOT / "workflow" / "eitskin" / "paper" / "printed_table_2.csv"
SKIN = {
    "radius_mm": 80.0,
    "thickness_mm": 3.0,
    "conductivity_S_per_m": 0.5,
    "electrode_deg": even_angles(16).tolist(),
    "electrode_width_mm": 0.0,
    "contact_impedivity_ohm_m2": 0.0,
    "current_A": 0.001,
    "contrast_per_N": 0.9,
}
SHARES = ((np.arange(12) + 0.4) / 12).tolist()
GAIN = {"name": "channel-gain", "parameters": {"gain": {"sd": 0.1}}}
OFFSET = {"name": "offset", "parameters": {"volt": 0.005}}


@pytest.fixture
def write(tmp_path):
    """A function that writes Table II of recordings, by name, and returns CSV, text, left out."""
    force_N = np.array([2.0, 5.0, 8.0])

    def written(recordings, effects=(GAIN, OFFSET), noise=1e-3, skin=SKIN, **changed):
        paths = {}
        for name, recorded in recordings.items():
            paths[name] = tmp_path / f"{name}.parquet"
            recording.write(recorded, paths[name])
        size = {"sessions": 8, "frames": 2, "permutations": 39} | changed
        block = {"effects": list(effects), "noise": noise}
        files = tmp_path / "table_2.csv", tmp_path / "table_2.md"
        plan = Plan(size["sessions"], size["frames"], force_N, "train", 1)
        design = table_2.Design(skin, plan, size["permutations"])
        left_out = table_2.write(paths, {"mine": block}, design, PAPER, *files)
        return pd.read_csv(files[0], keep_default_na=False), files[1].read_text(), left_out

    return written


def test_the_paper_s_numbers_are_all_there():
    paper = pd.read_csv(PAPER).set_index(["simulation", "measure"])["value"]
    assert len(paper) == 8
    assert (paper["plain", "mmd"], paper["all", "coral"], paper["all", "ncc"]) == (
        1.39,
        151.9,
        0.733,
    )


def test_a_row_for_each_simulation_and_measure(write, make_recording):
    table, text, left_out = write({"bench": make_recording()})
    assert left_out == []
    names = ["plain", "all", "channel-gain", "offset", "noise-free"]
    assert table["simulation"].drop_duplicates().tolist() == names
    assert table["measure"].tolist() == ["mmd", "coral", "ncc", "swd"] * 5
    assert set(table[table["simulation"] == "plain"]["notices"]) == {""}
    assert set(table[table["simulation"] == "all"]["notices"]) <= {"yes", "no"}
    cells = table.set_index(["simulation", "measure"])
    assert cells.loc[("plain", "swd"), "paper"] == "77.5"
    assert cells.loc[("offset", "swd"), "paper"] == ""
    outside = (table["notices"] == "yes") == (table["direction"] != "")
    assert outside.all()
    assert "## bench (simulated) · mine" in text and "(77.5)" in text


def test_the_change_is_the_difference_to_plain_and_its_band_decides(write, make_recording):
    table = write({"bench": make_recording()})[0]
    cell = table.set_index(["simulation", "measure"])
    for simulation in ("all", "channel-gain", "offset", "noise-free"):
        for measure in ("mmd", "coral", "ncc", "swd"):
            row, plain = cell.loc[simulation, measure], cell.loc["plain", measure]
            change = float(row["change"])
            expected = float(row["value"]) - float(plain["value"])
            scale = abs(float(row["value"])) + abs(float(plain["value"]))
            assert change == pytest.approx(expected, abs=1e-4 * scale)
            inside = float(row["band_low"]) <= change <= float(row["band_high"])
            assert row["notices"] == ("no" if inside else "yes")


def test_a_gain_is_noticed_by_the_covariance_and_an_offset_is_not(write, make_recording):
    cell = write({"bench": make_recording()})[0].set_index(["simulation", "measure"])["notices"]
    assert cell["channel-gain", "coral"] == "yes"
    assert cell["offset", "coral"] == "no"


def test_another_unit_is_brought_to_the_recording_s_level(write, make_recording):
    recorded = make_recording()
    recorded.metadata["unit"] = "arbitrary"
    table, text, _ = write({"bench": recorded})
    scale = float(table["scale"].iloc[0])
    assert scale == pytest.approx(0.5 * 3e-3 / 1e-3, rel=1e-2)
    assert "Its unit is not volt" in text


def test_magnitudes_and_other_protocols_are_simulated_as_they_were_recorded(write, make_recording):
    recorded = make_recording(channel_table(16, "opposite", "adjacent"))
    recorded.voltage = np.abs(recorded.voltage)
    recorded.metadata |= {"voltage": "magnitude", "unit": "arbitrary"}
    table = write({"bench": recorded}, effects=[GAIN])[0]
    assert set(table["channels"]) == {len(recorded.channels)}
    cell = table.set_index(["simulation", "measure"])["value"]
    assert cell["noise-free", "ncc"] == pytest.approx(1.0, abs=1e-3)


def test_lost_channels_are_left_to_the_others(write, make_recording):
    recorded = make_recording()
    recorded.voltage[:, 5] = np.nan
    assert set(write({"bench": recorded})[0]["channels"]) == {207}


def test_what_cannot_be_compared_is_left_out_loudly(write, make_recording):
    recorded, differences, short = make_recording(), make_recording(), make_recording(presses=2)
    differences.metadata["values"] = "difference"
    nowhere = make_recording()
    nowhere.metadata["skin"]["electrode_deg"] = None
    gone = make_recording(presses=2)
    gone.voltage[3:] = np.nan
    table, text, left_out = write(
        {"bench": recorded, "lab": differences, "nowhere": nowhere, "few": short, "gone": gone}
    )
    assert set(table["recording"]) == {"bench"}
    assert [line.split()[0] for line in left_out] == ["lab", "nowhere", "few", "gone"]
    reasons = ("differences", "null", "17 whole ones", "every channel lost")
    for line, reason in zip(left_out, reasons, strict=True):
        assert reason in line and f"**{line}**" in text


def test_a_recording_of_an_outline_is_simulated_within_it(write, make_recording):
    places = {"radius_mm": None, "electrode_deg": None, "electrode_s": SHARES}
    outlined = (
        SKIN | places | {"outline": {"shape": "rectangle", "width_mm": 90.0, "height_mm": 50.0}}
    )
    skin = Skin.from_metadata(outlined)
    channels = channel_table(12)
    frames = recording.frames_table(0.5 * np.arange(30), np.zeros(30, bool))
    metadata = recording.metadata_of(channels, skin.metadata(), "simulation", "signed", frame_s=0.1)
    rectangle = recording.Recording(frames, None, None, None, metadata)
    voltage = simulate(frames, np.full(30, -1), skin, channels, [], "train")
    scale = 1e-3 * np.median(np.abs(voltage))
    rectangle.voltage = voltage + scale * np.random.default_rng(1).standard_normal(voltage.shape)
    for nominal in (SKIN, outlined):
        table, _, left_out = write({"rectangle": rectangle}, [GAIN], skin=nominal)
        assert not left_out
        plain = table[(table["simulation"] == "plain") & (table["measure"] == "ncc")]
        assert plain["value"].astype(float).iloc[0] > 0.999
    with pytest.raises(InputError, match=r"skin\.outline: found an outline, expected a disc"):
        write({"bench": make_recording()}, [GAIN], skin=outlined)


def test_nothing_to_compare_is_refused(write, make_recording):
    recorded = make_recording()
    recorded.metadata["values"] = "difference"
    with pytest.raises(InputError, match=r"table_2: recordings: found .*one that can be compared"):
        write({"lab": recorded})


def test_equal_input_gives_equal_bytes(write, make_recording, tmp_path):
    write({"bench": make_recording()})
    file_bytes = [(tmp_path / f"table_2.{kind}").read_bytes() for kind in ("csv", "md")]
    write({"bench": make_recording()})
    assert file_bytes == [(tmp_path / f"table_2.{kind}").read_bytes() for kind in ("csv", "md")]


def test_the_reading_says_what_the_numbers_say():
    cells = []
    for simulation, change in (("plain", np.nan), ("all", -0.5), ("ellipse", -0.4), ("gain", 0.0)):
        for measure in ("mmd", "coral"):
            is_noticed = measure == "mmd" and simulation in ("all", "ellipse")
            cells.append(
                {
                    "simulation": simulation,
                    "measure": measure,
                    "value": 1.0,
                    "halves_low": 0.0,
                    "halves_high": 0.5 if measure == "mmd" else 2.0,
                    "change": change,
                    "notices": "" if simulation == "plain" else "yes" if is_noticed else "no",
                    "direction": "nearer" if is_noticed else "",
                    "mmd_within_simulation": 0.2 if simulation == "all" else 0.8,
                    "mmd_within_recording": 0.5,
                    "mmd_across": 0.1 if simulation == "plain" else 0.05,
                }
            )
    text = "\n".join(table_2.reading(pd.DataFrame(cells)))
    assert "MMD tells the plain simulation from another half" in text
    assert "MMD notices ellipse (nearer); not gain." in text
    assert "CORAL notices none; not ellipse and gain." in text
    assert "nearer by MMD; farther by none; the same by CORAL." in text
    assert "makes -0.60" in text and "sets +0.10" in text
