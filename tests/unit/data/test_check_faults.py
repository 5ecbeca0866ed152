"""Faults of a rig and slips of an owner, told by the check and left out of a diagnosis."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import yaml

from eitskin.data import alignment, check, importers
from eitskin.data.check import ERROR, FACT, WARNING, wiring
from eitskin.data.check.copies import copies
from eitskin.data.check.loads import lost_forces
from eitskin.data.check.placeholders import measured
from eitskin.data.check.second_touches import second_touches
from eitskin.data.check.unlabelled import labelled
from eitskin.data.check.usable import usable
from eitskin.data.importers.description import describe
from eitskin.data.recording import UNTOUCHED_FORCE, Recording, frames_table, presses
from eitskin.diagnose.parts import diagnose
from eitskin.diagnose.verdict.conclusion import document
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table
from small_skin import CHANNELS, small_recording


def finding(recording, topic):
    (told,) = check.check(recording).of_topic(topic)
    return told


@pytest.mark.parametrize("number", [9.9e37, -9999.0, 0.0])
def test_a_number_in_the_place_of_readings_is_said_and_left_out(number):
    recording = small_recording()
    is_lost = np.random.default_rng(1).random(recording.voltage.shape) < 0.01
    recording.voltage[is_lost] = number
    report = check.check(recording)
    assert report.ok and f"{is_lost.sum()} readings are {number:.6g}" in check.text(report)
    assert (np.isnan(measured(recording).voltage) == is_lost).all()
    assert document(diagnose(recording), "lost")["verdict"] == "consistent"


def test_readings_alone_are_all_measured():
    recording = small_recording(noise=1e-3)
    step = np.abs(recording.voltage).max() / 1024
    recording.voltage = np.round(recording.voltage / step) * step
    assert measured(recording) is recording


@pytest.mark.parametrize(("electrodes", "reading"), [((3,), 0.0), ((0,), np.nan), ((1, 6), 5.0)])
def test_an_unplugged_electrode_is_one_finding(make_recording, electrodes, reading):
    recording = make_recording(presses=12)
    recording.voltage[:, np.isin(recording.channels, electrodes).any(axis=1)] = reading
    names = "electrode 3 is" if electrodes == (3,) else "electrode 0 is"
    names = "electrodes 1 and 6 are" if len(electrodes) == 2 else names
    assert f"{names} not connected" in finding(recording, "unplugged").sentence
    report = check.check(recording)
    assert [item.topic for item in report.of_severity(WARNING)] == ["unplugged"] and report.ok


def test_a_broken_wire_on_a_coarse_converter_is_usable_and_diagnosed():
    recording = small_recording({"name": "electrode-open", "electrodes": [5]})
    step = np.abs(recording.voltage).max() / 1024
    recording.voltage = np.round(recording.voltage / step) * step
    told = finding(recording, "order")
    assert told.severity == WARNING and "hardly any without electrode 5" in told.sentence
    (effect,) = document(diagnose(recording), "open")["effects"]
    assert effect["name"] == "electrode-open" and effect["electrodes"] == [5]


def noisy_differences(make_recording, seed):
    recording = make_recording(presses=12, noise=1e-9)
    touched = recording.frames["touch"].to_numpy()
    voltage = recording.voltage - recording.voltage[~touched].mean(axis=0)
    size = np.sqrt((voltage[touched] ** 2).mean())
    voltage += 0.4 * size * np.random.default_rng(seed).normal(size=voltage.shape)
    return replace(
        recording, voltage=voltage, metadata=recording.metadata | {"values": "difference"}
    )


def test_noise_of_differences_is_no_broken_order(make_recording):
    recording = noisy_differences(make_recording, 0)
    assert finding(recording, "order").severity == FACT
    recording.voltage = recording.voltage[:, np.random.default_rng(1).permutation(208)]
    assert finding(recording, "order").severity == ERROR


def test_copies_of_frames_are_told_and_equal_frames_of_a_coarse_converter_are_none():
    recording = small_recording()
    recording.voltage[1::2] = recording.voltage[::2]
    assert copies(recording).tolist() == list(range(1, len(recording.voltage), 2))
    assert "17 frames (1, 3, 5, ...) are copies" in finding(recording, "copies").sentence
    assert usable(recording)[0].frames["frame"].tolist() == list(range(0, 34, 2))
    quiet = small_recording(noise=1e-6)
    step = np.abs(quiet.voltage).max() / 128
    quiet.voltage = np.round(quiet.voltage / step) * step
    assert not len(copies(quiet))


def test_a_force_that_falls_while_the_probe_presses_on_is_told():
    recording = small_recording()
    assert not len(lost_forces(recording))
    recording.frames.loc[[11, 12], "force_N"] = 0.05
    assert lost_forces(recording).tolist() == [11, 12]
    assert (
        "force_N falls to 0.05 N in 2 frames (11 to 12)"
        in finding(recording, "lost force").sentence
    )
    assert set(range(34)) - {*usable(recording)[0].frames["frame"]} == {11, 12}


def test_places_in_another_order_than_the_presses_do_not_belong_to_the_readings():
    recording = small_recording(places=8, seed=2)
    assert not check.check(recording).of_topic("places")
    press, places = presses(recording), recording.frames[["x_mm", "y_mm"]].to_numpy()
    first = np.array([np.flatnonzero(press == number)[0] for number in range(8)])
    touched = press >= 0
    recording.frames.loc[touched, ["x_mm", "y_mm"]] = places[first[(press[touched] + 3) % 8]]
    told = finding(recording, "places")
    assert told.severity == ERROR and "do not belong together" in told.sentence
    assert not check.check(recording).of_topic("numbering")


def two_touches(scale):
    recording, other = (
        small_recording(places=8, noise=0.0),
        small_recording(places=8, seed=50, noise=0.0),
    )
    rows = np.isin(presses(recording), [1, 6])
    recording.voltage[rows] += scale * (other.voltage[rows] - other.voltage[0])
    noise = 1e-3 * np.median(np.abs(recording.voltage))
    recording.voltage += noise * np.random.default_rng(3).normal(size=recording.voltage.shape)
    return recording, np.flatnonzero(rows)


def test_presses_with_a_second_touch_that_no_label_tells_are_found_and_left_out():
    recording, rows = two_touches(0.6)
    assert np.concatenate(second_touches(recording)).tolist() == rows.tolist()
    assert "8 frames (10 to 13, 35 to 38)" in finding(recording, "second").sentence
    rest, stretches = labelled(recording)
    assert stretches == [(10, 13), (35, 38)] and len(rest.frames) == len(recording.frames) - 8
    assert not second_touches(two_touches(0.0)[0])


@pytest.mark.parametrize("digits", [2, 3])
def test_readings_of_few_digits_are_neither_stuck_nor_clipped(make_recording, digits):
    recording = make_recording(presses=0, noise=1e-5)
    largest = np.abs(recording.voltage).max()
    recording.voltage = np.round(recording.voltage / largest * 10**digits) / 10**digits
    told = {item.topic for item in check.check(recording).findings if item.severity != FACT}
    assert told.isdisjoint({"stuck", "clipped", "placeholder"})
    assert "digits are too few" in finding(recording, "noise").sentence


def test_the_rounding_of_a_computation_is_no_step_between_readings(make_recording):
    recording = make_recording(presses=0)
    recording.voltage[:] = 1.0
    recording.voltage[::9] = np.nextafter(1.0, 2.0)
    assert "repeats itself" in finding(recording, "noise").sentence


def test_a_channel_that_never_changes_among_others_that_do_is_stuck():
    recording = small_recording()
    recording.voltage[:, 7] = recording.voltage[0, 7]
    assert finding(recording, "stuck").sentence.endswith("never changes: stuck or dead.")


@pytest.mark.parametrize("corner_mm", [(40.0, 40.0), (45.0, 55.0), (0.0, -60.0)])
def test_places_that_are_not_counted_from_the_centre_are_told(make_recording, corner_mm):
    recording = make_recording(presses=12)
    radius_mm = recording.skin.radius_mm
    skin = recording.metadata["skin"] | {"radius_mm": None}
    recording.metadata = recording.metadata | {"skin": skin}
    assert finding(recording, "numbering").severity == FACT
    shift_mm = np.array(corner_mm) * radius_mm / 40.0
    recording.frames[["x_mm", "y_mm"]] += shift_mm
    told = finding(recording, "numbering")
    assert told.severity == ERROR and "not counted from the skin's centre" in told.sentence
    centre_mm = wiring.numbering(recording).centre_mm
    assert np.abs(np.array(centre_mm) - shift_mm).max() < 0.1 * radius_mm


def test_one_channel_shows_no_direction_and_is_diagnosed():
    recording = small_recording()
    metadata = recording.metadata | {"channels": recording.metadata["channels"][:1]}
    few = replace(recording, voltage=recording.voltage[:, :1], metadata=metadata)
    assert wiring.numbering(few) is None
    assert document(diagnose(few), "few")["verdict"] == "consistent"


def test_noise_as_large_as_readings_is_told(make_recording):
    recording = make_recording(presses=0, noise=1.0)
    assert finding(recording, "noise").severity == WARNING


DRIFTS = {
    "rises": lambda elapsed: 1.0 + 0.17 * elapsed,
    "falls": lambda elapsed: np.exp(-0.35 * elapsed),
    "settles": lambda elapsed: 1.0 + 0.25 * (1.0 - np.exp(-3.0 * elapsed)),
    "returns": lambda elapsed: 1.0 + 0.3 * np.sin(np.pi * elapsed),
}


@pytest.mark.parametrize("drift", DRIFTS.values(), ids=DRIFTS)
@pytest.mark.parametrize("electrodes", [8, 16])
def test_readings_that_drift_together_still_show_touches_at_their_places(
    make_recording, drift, electrodes
):
    recording = small_recording() if electrodes == 8 else make_recording(presses=12)
    recording.voltage *= drift(np.linspace(0.0, 1.0, len(recording.voltage)))[:, None]
    report = check.check(recording)
    assert report.ok and not report.of_severity(WARNING)
    assert abs(wiring.numbering(recording).turn_deg) < 2.0


@pytest.mark.parametrize("ratio", [2.0, 0.5])
def test_a_radius_stated_as_a_diameter_is_named(ratio):
    probe = {"name": "probe-radius", "parameters": {"ratio": ratio}}
    (effect,) = document(diagnose(small_recording(probe, noise=3e-4)), "probe")["effects"]
    assert effect["name"] == "probe-radius" and effect["certain"]
    assert np.isclose(effect["parameters"]["ratio"]["value"], ratio, rtol=0.01)


@pytest.mark.long
def test_beside_readings_that_drift_together_an_electrode_is_named():
    moved = {"name": "electrode-position", "electrodes": [5], "parameters": {"shift_deg": [4.0]}}
    recording = small_recording(moved, noise=3e-4)
    elapsed = np.linspace(0.0, 1.0, len(recording.voltage))
    recording.voltage *= (1.0 + 0.17 * elapsed)[:, None]
    said = document(diagnose(recording), "drift")
    by_name = {effect["name"]: effect for effect in said["effects"]}
    assert by_name["electrode-position"]["electrodes"] == [5]
    sds = {component["name"]: component["sd"] for component in said["noise"]["components"]}
    assert "conductivity-drift" in by_name or sds["gain-walk"] > 0.03
    assert by_name.keys() <= {"electrode-position", "conductivity-drift"}


@pytest.mark.parametrize(
    ("zero_N", "sd_N", "walk_N"), [(2.0, 0.0, 0.0), (0.4, 0.05, 0.0), (-0.3, 0.01, 0.2)]
)
def test_a_load_cell_whose_zero_is_off_is_told_by_untouched_frames(tmp_path, zero_N, sd_N, walk_N):
    recording = small_recording()
    draw, labels = np.random.default_rng(3), recording.frames[["touch", "x_mm", "y_mm"]].copy()
    count = len(labels)
    off_N = zero_N + walk_N * np.linspace(0.0, 1.0, count) + sd_N * draw.normal(size=count)
    labels["force_N"] = recording.frames["force_N"] + off_N
    table = pd.concat([labels, pd.DataFrame(recording.voltage).add_prefix("v")], axis=1)
    table.to_csv(tmp_path / "r.csv", index=False)
    description = {"electrodes": 8, "drive": "adjacent", "measurement": "adjacent"}
    (tmp_path / "r.yaml").write_text(yaml.safe_dump(description))
    imported = importers.load(tmp_path / "r.csv")
    untouched = ~labels["touch"].to_numpy(bool)
    told = finding(imported, "zero")
    assert told.severity == WARNING and "the load cell's zero is off" in told.sentence
    assert np.isclose(told.value, np.median(off_N[untouched]))
    assert (imported.frames["force_N"][untouched] == 0.0).all()


def test_a_load_cell_whose_zero_jumps_is_told_though_most_report_none(make_recording):
    draw, recording = np.random.default_rng(3), make_recording(presses=20)
    force_N = 0.6 * (np.arange(len(recording.frames)) > 0.6 * len(recording.frames))
    force_N = force_N + 0.02 * draw.normal(size=len(force_N))
    recording.frames[UNTOUCHED_FORCE] = np.where(recording.frames["touch"], np.nan, force_N)
    assert "the load cell's zero wanders" in finding(recording, "zero").sentence


def test_noise_of_a_load_cell_is_no_zero_that_is_off():
    draw, recording = np.random.default_rng(3), small_recording()
    force_N = 0.05 * draw.normal(size=len(recording.frames))
    recording.frames[UNTOUCHED_FORCE] = np.where(recording.frames["touch"], np.nan, force_N)
    assert not check.check(recording).of_topic("zero")


def test_opposite_pairs_read_a_touch_alike_across_the_centre(make_recording):
    channels = channel_table(16, "opposite", "opposite")
    recording = make_recording(presses=20, channels=channels)
    (numbering,) = check.check(recording).of_topic("numbering")
    assert numbering.severity == FACT


@pytest.mark.parametrize(("offset", "noise"), [(0.0, 1.0), (1.0, 1e-4)])
def test_a_broken_wire_does_not_move_places(make_recording, offset, noise):
    recording = make_recording(presses=12)
    uses, draw = (recording.channels == 9).any(axis=1), np.random.default_rng(0)
    floating = offset * draw.normal(size=len(uses)) + noise * draw.normal(
        size=recording.voltage.shape
    )
    floating[20:] += 0.1 * offset * draw.normal(size=len(uses))
    voltage = np.where(uses, np.abs(recording.voltage).max() * floating, recording.voltage)
    report = check.check(replace(recording, voltage=voltage))
    assert ("without electrode 9" in report.of_topic("order")[0].sentence) == bool(offset)
    assert report.of_topic("numbering")[0].severity == FACT


@pytest.mark.parametrize(
    ("numbers", "frames", "steady"),
    [
        (range(12), [6] * 11 + [9], (66, 74)),
        # A touch without a label is most of the last part.
        ((12, *range(11), 12, 11, 12), [12, *[6] * 11, 3, 20, 3], (0, 11)),
    ],
)
def test_dozens_of_steps_are_one_line(make_recording, numbers, frames, steady):
    recording = make_recording(presses=0, noise=1e-4)
    draw, level = np.random.default_rng(0), recording.voltage.mean(axis=0)
    places = 0.6 * np.exp(2j * np.pi * draw.random(12))
    change = alignment.sensitivity(
        recording.channels, np.array(recording.skin.electrode_deg), places
    )
    states = level + 0.02 * np.abs(level).mean() * change / np.abs(change).mean()
    states = np.vstack([states, level])
    voltage = np.repeat(states[[*numbers]], frames, axis=0)
    voltage += 1e-4 * np.abs(level).mean() * draw.normal(size=voltage.shape)
    table = recording.frames.iloc[np.zeros(len(voltage), int)].reset_index(drop=True)
    table = table.assign(frame=np.arange(len(voltage)), time_s=0.4 * np.arange(len(voltage)))
    told = finding(replace(recording, frames=table, voltage=voltage), "steps")
    assert "steps, the largest from frame" in told.sentence and told.stretch == steady


def test_touched_frames_with_a_blank_place_are_left_out_and_said(tmp_path):
    recording = small_recording()
    table = recording.frames[["time_s", "touch", "x_mm", "y_mm", "force_N"]].copy()
    table["touch"] = table["touch"].astype(int)
    table.loc[10:13, ["x_mm", "y_mm"]] = np.nan
    for channel in range(len(CHANNELS)):
        table[f"c{channel}"] = recording.voltage[:, channel]
    table.to_csv(tmp_path / "press.csv", index=False)
    names = ", ".join(f"{name}: {name}" for name in table.columns[:5])
    (tmp_path / "press.yaml").write_text(
        f"{{electrodes: 8, drive: adjacent, measurement: adjacent, labels: {{{names}}}}}\n"
    )
    loaded = importers.load(tmp_path / "press.csv")
    assert (
        len(loaded.frames) == len(table) - 4 and loaded.frames["frame"].iloc[-1] == len(table) - 5
    )
    assert "4 touched frames, whose place the labels leave blank" in loaded.metadata["source"]


@pytest.mark.parametrize("electrodes", [8, 16])
def test_absolute_readings_that_are_noise_are_of_no_skin(electrodes):
    """And no differences, as touches do not change them by more than their noise."""
    touch = np.tile([False, True], 30)
    frames = frames_table(np.arange(60.0), touch, np.arange(60.0), 0.0, 1.0 + np.arange(60.0))
    channels = channel_table(electrodes)
    metadata = describe(channels, even_angles(electrodes), "a citation", "signed")
    noise = np.random.default_rng(electrodes).normal(size=(60, len(channels)))
    checked = check.check(Recording(frames, noise, None, None, metadata))
    (error,) = checked.of_severity(check.ERROR)
    assert error.topic == "order" and error.sentence.startswith("exchanging drive and")
