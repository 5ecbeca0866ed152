"""What `check` suspects of units and device: each where it is planted, none where it is not."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from eitskin.data import check, importers, subset
from eitskin.data.alignment import homogeneous_readings
from eitskin.data.check import (
    ERROR,
    WARNING,
    clipping,
    compliance,
    plausibility,
    sentences,
    suspicions,
)
from eitskin.data.check.exchange import exchanged_channels
from eitskin.data.check.steps import steps
from eitskin.data.recording import Recording
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table
from shared_data import shared_data
from small_skin import small_recording
from witness import cases

SUSPECTED = {"units", "constant", "unseen", "clipped", "exchanged", "drives", "step"}
NULLS = ["null", "null+rig", "null+rig:gain-walk,correlated-noise,channel-drift"]
REAL = [
    "hydrogel-skin/ohmc16.mat",
    "hydrogel-skin/ohmc8.mat",
    "patterned-skin/inp_noPattern.csv",
    "iirc-tank/iirc_data_2006.mat",
    "lct-tank/homogeneous",
    "lct-tank/objects",
    "pyeidors-tank/measurements/tank",
]
per_example = settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
seeds = st.integers(0, 10**6)


def suspected(recording):
    """Topics at which something looks wrong."""
    grave = (WARNING, ERROR)
    return {f.topic for f in check.check(recording).findings if f.severity in grave} & SUSPECTED


def doubted(recording):
    return {doubt.key: doubt for doubt in plausibility.doubts(recording)}


def untouched(recording):
    return np.flatnonzero(~recording.frames["touch"].to_numpy(dtype=bool))


@pytest.mark.parametrize("kind", NULLS)
@pytest.mark.parametrize("seed", range(1, 6))
def test_nothing_is_suspected_of_a_skin_with_nothing_left_out(kind, seed):
    case = cases.draw(kind, seed)
    recording = Recording(case.states, case.voltage, None, None, case.metadata)
    assert not suspected(recording)


@pytest.mark.parametrize("name", REAL)
def test_nothing_is_suspected_of_real_recordings(name):
    path = shared_data(name)
    alone = path.is_file() or name.endswith("homogeneous")
    ends = (".txt", ".csv")
    paths = [path] if alone else [p for p in path.rglob("*") if Path(p).suffix in ends]
    assert paths
    for recording_path in paths:
        assert not suspected(importers.load(recording_path)), recording_path


@pytest.mark.parametrize("pattern", ["adjacent", "opposite", "skip-2"])
def test_nothing_is_suspected_of_other_patterns(make_recording, pattern):
    assert not suspected(make_recording(channel_table(16, pattern)))


# --- units ---


@per_example
@given(times=st.floats(12.0, 1e6), small=st.booleans())
def test_readings_far_from_the_believed_disc_are_doubted_with_their_factor(times, small):
    recording = small_recording(places=1)
    amplitude_V = plausibility.amplitude(recording)
    assert amplitude_V == pytest.approx(1.0, abs=0.5) and "voltage_V" not in doubted(recording)
    factor = 1.0 / (amplitude_V * times) if small else times / amplitude_V
    recording.voltage *= factor
    doubt = doubted(recording)["voltage_V"]
    assert doubt.factor == pytest.approx(amplitude_V * factor)
    assert ("mV given as V" in doubt.likely_mistake) == (100 < doubt.factor < 1e4)
    assert ("mA given as A" in doubt.likely_mistake) == (1e-4 < doubt.factor < 1e-2)


def test_the_amplitude_of_point_electrodes_is_one(make_recording):
    recording = make_recording(presses=0, noise=0.0)
    assert plausibility.amplitude(recording) is None  # nobody knows the sheet
    recording.metadata["skin"] |= {"thickness_mm": 3.0, "conductivity_S_per_m": 0.4}
    shape = homogeneous_readings(recording.channels, np.array(recording.skin.electrode_deg))
    recording.voltage[:] = shape * 1e-3 / (0.4 * 3e-3)
    assert plausibility.amplitude(recording) == pytest.approx(1.0)
    recording.metadata["unit"] = "ohm"
    recording.voltage /= 1e-3
    assert plausibility.amplitude(recording) == pytest.approx(1.0)
    recording.metadata["unit"] = "arbitrary"
    assert plausibility.amplitude(recording) is None


@pytest.mark.parametrize(
    ("key", "value_in_unit", "bad", "says"),
    [
        ("radius_mm", 6.0, 0.08, "m given as mm"),
        ("radius_mm", 4000.0, 80e3, "µm given as mm"),
        ("thickness_mm", 0.1, 0.003, "m given as mm"),
        ("electrode_width_mm", 0.2, 0.005, "m given as mm"),
        ("current_A", 0.02, 1.0, "a default that nobody measured"),
        ("current_A", 1e-5, 5.0, "mA given as A"),
        ("current_A", 1e-7, 1e-9, "kA given as A"),
    ],
)
def test_a_skin_of_another_unit_is_doubted(make_recording, key, value_in_unit, bad, says):
    recording = make_recording(presses=0)
    recording.metadata["skin"][key] = value_in_unit
    assert not doubted(recording)
    recording.metadata["skin"][key] = bad
    (doubt,) = doubted(recording).values()
    assert doubt.key == f"skin.{key}" and says in doubt.likely_mistake
    (finding,) = suspicions.units(recording)
    assert finding.severity == WARNING and f"skin.{key}" in finding.sentence


@per_example
@given(power=st.sampled_from([-3, 3]), column=st.sampled_from(["place", "probe_mm", "depth_mm"]))
def test_lengths_of_touches_in_metres_or_micrometres_are_doubted(make_recording, power, column):
    recording = make_recording(presses=4)
    recording.frames["depth_mm"] = (
        recording.frames["force_N"].where(recording.frames["touch"]) * 0.5
    )
    assert not doubted(recording)
    names = ["x_mm", "y_mm"] if column == "place" else [column]
    recording.frames[names] *= 10.0**power
    if column == "place" and power > 0:
        return  # `recording.validate` refuses places off the skin
    ((key, doubt),) = doubted(recording).items()
    assert key == ("x_mm, y_mm" if column == "place" else column)
    assert doubt.factor == 10.0**power


def test_places_near_the_centre_of_a_robot_frame_are_no_doubt(make_recording):
    recording = make_recording(presses=4)
    recording.frames[["x_mm", "y_mm"]] *= 1e-3
    recording.metadata["position_frame"] = "robot"
    assert not doubted(recording)


@pytest.mark.parametrize(
    ("times", "probe", "says"),
    [
        (1e-5, 10.0, "kN given as N"),
        (1e2, 10.0, "grams given as N"),
        (1e3, 10.0, "mN given as N"),
        (1e3, None, "mN given as N"),
    ],
)
def test_forces_that_no_gel_bears_or_nobody_feels_are_doubted(make_recording, times, probe, says):
    recording = make_recording(presses=2)
    recording.frames["force_N"] *= times
    recording.frames["probe_mm"] = recording.frames["probe_mm"] * (np.nan if probe is None else 1.0)
    doubt = doubted(recording)["force_N"]
    assert says in doubt.likely_mistake and (doubt.factor < 1) == (times < 1)


def test_a_query_in_another_unit_is_doubted(make_recording):
    query = make_recording(presses=3)
    query.voltage = None
    assert not suspected(query)
    query.frames["force_N"] *= 1e3
    assert suspected(query) == {"units"}


@pytest.mark.parametrize("frame_s", [None, 0.3])
def test_times_in_milliseconds_are_doubted(make_recording, frame_s):
    recording = make_recording(presses=3)
    recording.metadata["frame_s"] = frame_s
    assert not doubted(recording)
    recording.frames["time_s"] *= 1e3
    assert set(doubted(recording)) == {"time_s"}
    recording.metadata["frame_s"] = 300.0
    assert set(doubted(recording)) == {"frame_s"}


# --- readings that do not respond ---


def test_constant_readings_are_an_error_where_somebody_touches(make_recording):
    recording = make_recording(presses=3)
    recording.voltage[:] = recording.voltage[0]
    (finding,) = suspicions.constant_frames(recording)
    assert finding.severity == ERROR and "12 of them" in finding.sentence
    assert not check.check(recording).ok
    recording = make_recording(presses=0)
    recording.voltage[:] = recording.voltage[0]
    (finding,) = suspicions.constant_frames(recording)
    assert finding.severity == WARNING
    recording.voltage[3, 7] *= 1.0 + 1e-12
    assert not suspicions.constant_frames(recording)


@per_example
@given(seed=seeds, noise=st.sampled_from([1e-4, 1e-3, 1e-2]))
def test_touches_that_change_nothing_are_said(make_recording, seed, noise):
    recording = make_recording(presses=10, noise=noise, seed=seed)
    assert not suspicions.unseen_touches(recording)
    touched = recording.frames["touch"].to_numpy(dtype=bool)
    recording.voltage[touched] = make_recording(presses=0, noise=0.0).voltage[0]
    draw = np.random.default_rng([seed, 1])
    shape = recording.voltage[touched].shape
    free = recording.voltage[untouched(recording)]
    # quieter than untouched frames, so that chance makes no difference
    recording.voltage[touched] += 0.5 * free.std(axis=0) * draw.standard_normal(shape)
    (finding,) = suspicions.unseen_touches(recording)
    assert finding.severity == WARNING and "40 touched frames" in finding.sentence


# --- ceilings ---


@per_example
@given(share=st.floats(0.5, 0.97), after=st.floats(0.05, 1.0), seed=seeds)
def test_a_ceiling_with_noise_after_it_is_found_where_touches_push_at_it(
    make_recording, share, after, seed
):
    noise = 1e-4
    recording = make_recording(presses=30, noise=noise, seed=seed)
    sd = noise * np.median(np.abs(recording.voltage[0]))
    assert not clipping.ceilings(recording)
    largest = np.abs(recording.voltage[untouched(recording)]).mean(axis=0).max()
    draw = np.random.default_rng([seed, 2])
    recording.voltage = np.clip(recording.voltage, -share * largest, share * largest)
    recording.voltage += after * sd * draw.standard_normal(recording.voltage.shape)
    (ceiling,) = clipping.ceilings(recording)
    assert ceiling.ceiling == pytest.approx(share * largest, rel=0.01)
    steps_apart = (recording.channels[:, 2] - recording.channels[:, 0]) % 16
    assert set(np.flatnonzero(np.isin(steps_apart, (2, 14)))) == set(ceiling.channels.tolist())
    (finding,) = sentences.clipped_channels(recording)
    assert finding.severity == WARNING and finding.value == pytest.approx(32 / 208)
    assert f"in {len(ceiling.frames)} frames" in finding.sentence


def test_squashed_noise_shows_a_ceiling_without_touches(make_recording):
    recording = make_recording(presses=0, noise=1e-2)
    largest = np.abs(recording.voltage).max()
    draw = np.random.default_rng(0)
    recording.voltage = np.clip(recording.voltage, -0.8 * largest, 0.8 * largest)
    recording.voltage += 1e-6 * largest * draw.standard_normal(recording.voltage.shape)
    (ceiling,) = clipping.ceilings(recording)
    assert ceiling.sign == "noise" and len(ceiling.frames) == len(recording.frames)


# --- weak drives ---


@per_example
@given(
    share=st.floats(0.5, 0.94),
    drives=st.sets(st.integers(0, 15), min_size=1, max_size=5),
    signed=st.booleans(),
    seed=seeds,
)
def test_drives_of_a_source_at_its_compliance_are_named(
    make_recording, share, drives, signed, seed
):
    recording = make_recording(presses=4, noise=1e-3, seed=seed)
    if not signed:
        recording.voltage = np.abs(recording.voltage)
        recording.metadata["voltage"] = "magnitude"
    assert compliance.weak_drives(recording) is None
    recording.voltage[:, np.isin(recording.channels[:, 0], list(drives))] *= share
    weak = compliance.weak_drives(recording)
    expected_pairs = {tuple(sorted((drive, (drive + 1) % 16))) for drive in drives}
    assert set(weak.drives) == expected_pairs
    assert weak.shares == pytest.approx([share] * len(drives), rel=0.01)
    (finding,) = suspicions.weak_drives(recording)
    assert finding.severity == WARNING and "compliance" in finding.sentence


def test_readings_that_break_reciprocity_at_random_are_no_weak_drives(make_recording):
    recording = make_recording(presses=0)
    recording.voltage *= 1.0 + 0.1 * np.random.default_rng(0).standard_normal(208)
    assert compliance.weak_drives(recording) is None


# --- two columns exchanged ---


@per_example
@given(rows=st.sets(st.integers(0, 207), min_size=2, max_size=2), signed=st.booleans(), seed=seeds)
def test_two_columns_in_each_others_place_are_named(make_recording, rows, signed, seed):
    recording = make_recording(presses=4, noise=1e-3, seed=seed)
    if not signed:
        recording.voltage = np.abs(recording.voltage)
        recording.metadata["voltage"] = "magnitude"
    assert exchanged_channels(recording) == []
    low_row, high_row = sorted(rows)
    level = np.abs(recording.voltage[0])
    assume(abs(level[low_row] - level[high_row]) > 0.1 * level[[low_row, high_row]].max())
    recording.voltage[:, [low_row, high_row]] = recording.voltage[:, [high_row, low_row]]
    exchanges = exchanged_channels(recording)
    assert (low_row, high_row) in exchanges and len(exchanges) in (2, 4)
    (finding,) = suspicions.exchanged_channels(recording)
    assert finding.severity == WARNING and f"{low_row} and {high_row}" in finding.sentence


@per_example
@given(
    rows=st.sets(st.integers(0, 207), min_size=2, max_size=2),
    factors=st.sampled_from([(0.0, 0.0), (1.3, 1.0), (1.3, 0.7)]),
    seed=seeds,
)
def test_a_broken_reciprocity_is_no_exchange(make_recording, rows, factors, seed):
    recording = make_recording(presses=4, noise=1e-3, seed=seed)
    recording.voltage[:, sorted(rows)] *= factors
    assert exchanged_channels(recording) == []


def test_two_channels_off_alike_are_told_as_that_too(make_recording):
    """In a disc channels at like distances read alike."""
    recording = make_recording(presses=0)
    recording.voltage[:] = homogeneous_readings(recording.channels, even_angles(16))
    size = np.abs(recording.voltage[0])
    row = 20
    equal_row = int(np.flatnonzero(np.isclose(size, size[row], rtol=1e-6))[-1])
    recording.voltage[:, [row, equal_row]] *= -1.0
    (finding,) = suspicions.exchanged_channels(recording)
    assert "Or two of these are off alike" in finding.sentence


# --- steps in time ---


def with_step(recording, frame, size, rows, seed):
    """A step of `size` noises over all channels together, in `rows`, from `frame` on."""
    sd = np.diff(recording.voltage[untouched(recording)], axis=0).std(axis=0) / np.sqrt(2.0)
    pattern = np.zeros(recording.voltage.shape[1])
    pattern[rows] = np.random.default_rng([seed, 3]).standard_normal(len(rows))
    recording.voltage[frame:] += size * sd * pattern / np.linalg.norm(pattern)
    return recording


@per_example
@given(seed=seeds, size=st.floats(80.0, 1e4), fraction=st.floats(0.0, 1.0))
def test_a_step_is_found_at_its_first_frame(make_recording, seed, size, fraction):
    recording = make_recording(presses=12, seed=seed)
    assert not steps(recording)
    rows = untouched(recording)
    low, high = rows[1] + 1, rows[-2]
    frame = round(low + fraction * int(high - low))
    (step,) = steps(with_step(recording, frame, size, np.arange(208), seed))
    assert step.frame == frame and step.between[0] < frame <= step.between[1]
    assert step.size == pytest.approx(size, rel=0.35) and step.factor is None


@per_example
@given(seed=seeds, electrode=st.integers(0, 15))
def test_a_step_of_one_electrode_names_it(make_recording, seed, electrode):
    recording = make_recording(presses=12, seed=seed)
    rows = np.flatnonzero((recording.channels == electrode).any(axis=1))
    (exchanges,) = steps(with_step(recording, 40, 300.0, rows, seed))
    assert exchanges.electrodes == (electrode,) and set(exchanges.channels) <= set(rows.tolist())
    (finding,) = suspicions.steps_in_time(recording)
    assert (
        f"electrode {electrode} takes part" in finding.sentence
        and "frame 40 on" in finding.sentence
    )
    assert finding.sentence.endswith("a contact moved.")
    recording.frames["touch"] = False
    sentences_of_steps = [finding.sentence for finding in suspicions.steps_in_time(recording)]
    assert all(
        ("moved" in finding_sentence) == ("touch that the file does not tell" in finding_sentence)
        for finding_sentence in sentences_of_steps
    )
    assert any("moved" in finding_sentence for finding_sentence in sentences_of_steps)


@per_example
@given(seed=seeds, change=st.floats(0.01, 0.3), sign=st.sampled_from([-1, 1]))
def test_a_gain_that_is_switched_is_a_step_by_a_factor(make_recording, seed, change, sign):
    recording = make_recording(presses=12, seed=seed)
    recording.voltage[33:] *= 1.0 + sign * change
    (exchanges,) = steps(recording)
    assert exchanges.between[0] < 33 <= exchanges.between[1] and not exchanges.electrodes
    assert exchanges.factor == pytest.approx(1.0 + sign * change, rel=0.01)


def test_two_steps_are_two(make_recording):
    recording = make_recording(presses=12)
    for frame in (20, 50):
        with_step(recording, frame, 500.0, np.arange(208), frame)
    assert [finding_sentence.frame for finding_sentence in steps(recording)] == [20, 50]


def test_another_session_and_differences_are_no_steps(make_recording):
    recording = with_step(make_recording(presses=12), 40, 500.0, np.arange(208), 0)
    recording.frames["session"] = np.where(recording.frames["frame"] < 40, "before", "after")
    assert not steps(recording)
    del recording.frames["session"]
    assert len(steps(recording)) == 1
    recording.metadata["values"] = "difference"
    assert not steps(recording)


@per_example
@given(seed=seeds, rho=st.sampled_from([0.0, 0.5, 0.9]), walk=st.sampled_from([0.0, 2e-3]))
def test_coloured_noise_walks_and_drift_are_no_steps(make_recording, seed, rho, walk):
    recording = make_recording(presses=0, noise=0.0)
    draw = np.random.default_rng(seed)
    length, width = 200, recording.voltage.shape[1]
    shape = recording.voltage[0]
    recording.frames = recording.frames.iloc[[0] * length].reset_index(drop=True)
    recording.frames["frame"], recording.frames["time_s"] = (
        np.arange(length),
        0.5 * np.arange(length),
    )
    noise = draw.standard_normal((length, width))
    for row in range(1, length):
        noise[row] = rho * noise[row - 1] + np.sqrt(1.0 - rho**2) * noise[row]
    gain = 1.0 + walk * np.cumsum(draw.standard_normal(length)) / np.sqrt(length)
    drift = 1.0 + np.linspace(0, 0.02, length)[:, None] * draw.standard_normal(width)
    recording.voltage = shape * gain[:, None] * drift + 1e-3 * np.median(np.abs(shape)) * noise
    assert not steps(recording)


# --- long recordings ---


def test_a_long_recording_has_the_steps_of_its_parts(make_recording, monkeypatch):
    recording = make_recording(presses=400)
    count = len(recording.frames)
    for frame in (count // 2, count - 300):
        recording = with_step(recording, frame, 60.0, np.arange(208), 0)
    whole = [(step.frame, step.between) for step in steps(recording)]
    monkeypatch.setattr(subset, "BLOCK_BYTES", 0)
    assert len(list(subset.blocks(recording))) > 2
    answered = [row for _, rows, _ in subset.blocks(recording) for row in rows]
    assert answered == [*range(count)]
    assert [(step.frame, step.between) for step in steps(recording)] == whole and len(whole) == 2


def test_a_check_takes_little_more_memory_than_the_readings(make_recording, monkeypatch):
    monkeypatch.setattr(subset, "BLOCK_BYTES", 0)
    short, long = (make_recording(presses=presses) for presses in (200, 800))
    peaks = []
    for recording in (short, long):
        tracemalloc.start()
        checked = check.check(recording)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert checked.ok and not checked.of_topic("step") and checked.of_topic("sample")
    assert peaks[1] - peaks[0] < long.voltage.nbytes - short.voltage.nbytes
