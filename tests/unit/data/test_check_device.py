"""What `check` suspects of units and device: each where it is planted, none where it is not."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from eitskin.data import check, importers
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


def suspected(made):
    """Topics at which something looks wrong."""
    grave = (WARNING, ERROR)
    return {f.topic for f in check.check(made).findings if f.severity in grave} & SUSPECTED


def doubted(made):
    return {doubt.key: doubt for doubt in plausibility.doubts(made)}


def untouched(made):
    return np.flatnonzero(~made.frames["touch"].to_numpy(dtype=bool))


@pytest.mark.parametrize("kind", NULLS)
@pytest.mark.parametrize("seed", range(1, 6))
def test_nothing_is_suspected_of_a_skin_with_nothing_left_out(kind, seed):
    case = cases.draw(kind, seed)
    made = Recording(case.states, case.voltage, None, None, case.metadata)
    assert not suspected(made)


@pytest.mark.parametrize("name", REAL)
def test_nothing_is_suspected_of_real_recordings(name):
    path = shared_data(name)
    alone = path.is_file() or name.endswith("homogeneous")
    ends = (".txt", ".csv")
    paths = [path] if alone else [p for p in path.rglob("*") if Path(p).suffix in ends]
    assert paths
    for one in paths:
        assert not suspected(importers.load(one)), one


@pytest.mark.parametrize("pattern", ["adjacent", "opposite", "skip-2"])
def test_nothing_is_suspected_of_other_patterns(make_recording, pattern):
    assert not suspected(make_recording(channel_table(16, pattern)))


# --- units ---


@per_example
@given(times=st.floats(12.0, 1e6), small=st.booleans())
def test_readings_far_from_the_believed_disc_are_doubted_with_their_factor(times, small):
    made = small_recording(places=1)
    before = plausibility.amplitude(made)
    assert before == pytest.approx(1.0, abs=0.5) and "voltage_V" not in doubted(made)
    factor = 1.0 / (before * times) if small else times / before
    made.voltage *= factor
    doubt = doubted(made)["voltage_V"]
    assert doubt.factor == pytest.approx(before * factor)
    assert ("mV given as V" in doubt.likely_mistake) == (100 < doubt.factor < 1e4)
    assert ("mA given as A" in doubt.likely_mistake) == (1e-4 < doubt.factor < 1e-2)


def test_the_amplitude_of_point_electrodes_is_one(make_recording):
    made = make_recording(presses=0, noise=0.0)
    assert plausibility.amplitude(made) is None  # nobody knows the sheet
    made.metadata["skin"] |= {"thickness_mm": 3.0, "conductivity_S_per_m": 0.4}
    shape = homogeneous_readings(made.channels, np.array(made.skin.electrode_deg))
    made.voltage[:] = shape * 1e-3 / (0.4 * 3e-3)
    assert plausibility.amplitude(made) == pytest.approx(1.0)
    made.metadata["unit"] = "ohm"
    made.voltage /= 1e-3
    assert plausibility.amplitude(made) == pytest.approx(1.0)
    made.metadata["unit"] = "arbitrary"
    assert plausibility.amplitude(made) is None


@pytest.mark.parametrize(
    ("key", "good", "bad", "says"),
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
def test_a_skin_of_another_unit_is_doubted(make_recording, key, good, bad, says):
    made = make_recording(presses=0)
    made.metadata["skin"][key] = good
    assert not doubted(made)
    made.metadata["skin"][key] = bad
    (doubt,) = doubted(made).values()
    assert doubt.key == f"skin.{key}" and says in doubt.likely_mistake
    (finding,) = suspicions.units(made)
    assert finding.severity == WARNING and f"skin.{key}" in finding.sentence


@per_example
@given(power=st.sampled_from([-3, 3]), column=st.sampled_from(["place", "probe_mm", "depth_mm"]))
def test_lengths_of_touches_in_metres_or_micrometres_are_doubted(make_recording, power, column):
    made = make_recording(presses=4)
    made.frames["depth_mm"] = made.frames["force_N"].where(made.frames["touch"]) * 0.5
    assert not doubted(made)
    names = ["x_mm", "y_mm"] if column == "place" else [column]
    made.frames[names] *= 10.0**power
    if column == "place" and power > 0:
        return  # `recording.validate` refuses places off the skin
    ((key, doubt),) = doubted(made).items()
    assert key == ("x_mm, y_mm" if column == "place" else column)
    assert doubt.factor == 10.0**power


def test_places_near_the_centre_of_a_robot_frame_are_no_doubt(make_recording):
    made = make_recording(presses=4)
    made.frames[["x_mm", "y_mm"]] *= 1e-3
    made.metadata["position_frame"] = "robot"
    assert not doubted(made)


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
    made = make_recording(presses=2)
    made.frames["force_N"] *= times
    made.frames["probe_mm"] = made.frames["probe_mm"] * (np.nan if probe is None else 1.0)
    doubt = doubted(made)["force_N"]
    assert says in doubt.likely_mistake and (doubt.factor < 1) == (times < 1)


def test_a_query_in_another_unit_is_doubted(make_recording):
    query = make_recording(presses=3)
    query.voltage = None
    assert not suspected(query)
    query.frames["force_N"] *= 1e3
    assert suspected(query) == {"units"}


@pytest.mark.parametrize("frame_s", [None, 0.3])
def test_times_in_milliseconds_are_doubted(make_recording, frame_s):
    made = make_recording(presses=3)
    made.metadata["frame_s"] = frame_s
    assert not doubted(made)
    made.frames["time_s"] *= 1e3
    assert set(doubted(made)) == {"time_s"}
    made.metadata["frame_s"] = 300.0
    assert set(doubted(made)) == {"frame_s"}


# --- readings that do not respond ---


def test_constant_readings_are_an_error_where_somebody_touches(make_recording):
    made = make_recording(presses=3)
    made.voltage[:] = made.voltage[0]
    (finding,) = suspicions.constant_frames(made)
    assert finding.severity == ERROR and "12 of them" in finding.sentence
    assert not check.check(made).ok
    made = make_recording(presses=0)
    made.voltage[:] = made.voltage[0]
    (finding,) = suspicions.constant_frames(made)
    assert finding.severity == WARNING
    made.voltage[3, 7] *= 1.0 + 1e-12
    assert not suspicions.constant_frames(made)


@per_example
@given(seed=seeds, noise=st.sampled_from([1e-4, 1e-3, 1e-2]))
def test_touches_that_change_nothing_are_said(make_recording, seed, noise):
    made = make_recording(presses=10, noise=noise, seed=seed)
    assert not suspicions.unseen_touches(made)
    touched = made.frames["touch"].to_numpy(dtype=bool)
    made.voltage[touched] = make_recording(presses=0, noise=0.0).voltage[0]
    draw = np.random.default_rng([seed, 1])
    shape = made.voltage[touched].shape
    free = made.voltage[untouched(made)]
    # quieter than untouched frames, so that chance makes no difference
    made.voltage[touched] += 0.5 * free.std(axis=0) * draw.standard_normal(shape)
    (finding,) = suspicions.unseen_touches(made)
    assert finding.severity == WARNING and "40 touched frames" in finding.sentence


# --- ceilings ---


@per_example
@given(share=st.floats(0.5, 0.97), after=st.floats(0.05, 1.0), seed=seeds)
def test_a_ceiling_with_noise_after_it_is_found_where_touches_push_at_it(
    make_recording, share, after, seed
):
    noise = 1e-4
    made = make_recording(presses=30, noise=noise, seed=seed)
    sd = noise * np.median(np.abs(made.voltage[0]))
    assert not clipping.ceilings(made)
    largest = np.abs(made.voltage[untouched(made)]).mean(axis=0).max()
    draw = np.random.default_rng([seed, 2])
    made.voltage = np.clip(made.voltage, -share * largest, share * largest)
    made.voltage += after * sd * draw.standard_normal(made.voltage.shape)
    (ceiling,) = clipping.ceilings(made)
    assert ceiling.ceiling == pytest.approx(share * largest, rel=0.01)
    steps_apart = (made.channels[:, 2] - made.channels[:, 0]) % 16
    assert set(np.flatnonzero(np.isin(steps_apart, (2, 14)))) == set(ceiling.channels.tolist())
    (finding,) = sentences.clipped_channels(made)
    assert finding.severity == WARNING and finding.value == pytest.approx(32 / 208)
    assert f"in {len(ceiling.frames)} frames" in finding.sentence


def test_squashed_noise_shows_a_ceiling_without_touches(make_recording):
    made = make_recording(presses=0, noise=1e-2)
    largest = np.abs(made.voltage).max()
    draw = np.random.default_rng(0)
    made.voltage = np.clip(made.voltage, -0.8 * largest, 0.8 * largest)
    made.voltage += 1e-6 * largest * draw.standard_normal(made.voltage.shape)
    (ceiling,) = clipping.ceilings(made)
    assert ceiling.sign == "noise" and len(ceiling.frames) == len(made.frames)


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
    made = make_recording(presses=4, noise=1e-3, seed=seed)
    if not signed:
        made.voltage = np.abs(made.voltage)
        made.metadata["voltage"] = "magnitude"
    assert compliance.weak_drives(made) is None
    made.voltage[:, np.isin(made.channels[:, 0], list(drives))] *= share
    found = compliance.weak_drives(made)
    wanted = {tuple(sorted((drive, (drive + 1) % 16))) for drive in drives}
    assert set(found.drives) == wanted
    assert found.shares == pytest.approx([share] * len(drives), rel=0.01)
    (finding,) = suspicions.weak_drives(made)
    assert finding.severity == WARNING and "compliance" in finding.sentence


def test_readings_that_break_reciprocity_at_random_are_no_weak_drives(make_recording):
    made = make_recording(presses=0)
    made.voltage *= 1.0 + 0.1 * np.random.default_rng(0).standard_normal(208)
    assert compliance.weak_drives(made) is None


# --- two columns exchanged ---


@per_example
@given(rows=st.sets(st.integers(0, 207), min_size=2, max_size=2), signed=st.booleans(), seed=seeds)
def test_two_columns_in_each_others_place_are_named(make_recording, rows, signed, seed):
    made = make_recording(presses=4, noise=1e-3, seed=seed)
    if not signed:
        made.voltage = np.abs(made.voltage)
        made.metadata["voltage"] = "magnitude"
    assert exchanged_channels(made) == []
    one, other = sorted(rows)
    level = np.abs(made.voltage[0])
    assume(abs(level[one] - level[other]) > 0.1 * level[[one, other]].max())
    made.voltage[:, [one, other]] = made.voltage[:, [other, one]]
    found = exchanged_channels(made)
    assert (one, other) in found and len(found) in (2, 4)
    (finding,) = suspicions.exchanged_channels(made)
    assert finding.severity == WARNING and f"{one} and {other}" in finding.sentence


@per_example
@given(
    rows=st.sets(st.integers(0, 207), min_size=2, max_size=2),
    factors=st.sampled_from([(0.0, 0.0), (1.3, 1.0), (1.3, 0.7)]),
    seed=seeds,
)
def test_a_broken_reciprocity_is_no_exchange(make_recording, rows, factors, seed):
    made = make_recording(presses=4, noise=1e-3, seed=seed)
    made.voltage[:, sorted(rows)] *= factors
    assert exchanged_channels(made) == []


def test_two_channels_off_alike_are_told_as_that_too(make_recording):
    """In a disc channels at like distances read alike."""
    made = make_recording(presses=0)
    made.voltage[:] = homogeneous_readings(made.channels, even_angles(16))
    size = np.abs(made.voltage[0])
    one = 20
    other = int(np.flatnonzero(np.isclose(size, size[one], rtol=1e-6))[-1])
    made.voltage[:, [one, other]] *= -1.0
    (finding,) = suspicions.exchanged_channels(made)
    assert "Or two of these are off alike" in finding.sentence


# --- steps in time ---


def stepped(made, frame, size, rows, seed):
    """A step of `size` noises over all channels together, in `rows`, from `frame` on."""
    sd = np.diff(made.voltage[untouched(made)], axis=0).std(axis=0) / np.sqrt(2.0)
    pattern = np.zeros(made.voltage.shape[1])
    pattern[rows] = np.random.default_rng([seed, 3]).standard_normal(len(rows))
    made.voltage[frame:] += size * sd * pattern / np.linalg.norm(pattern)
    return made


@per_example
@given(seed=seeds, size=st.floats(80.0, 1e4), at=st.floats(0.0, 1.0))
def test_a_step_is_found_at_its_first_frame(make_recording, seed, size, at):
    made = make_recording(presses=12, seed=seed)
    assert not steps(made)
    rows = untouched(made)
    low, high = rows[1] + 1, rows[-2]
    frame = round(low + at * int(high - low))
    (found,) = steps(stepped(made, frame, size, np.arange(208), seed))
    assert found.frame == frame and found.between[0] < frame <= found.between[1]
    assert found.size == pytest.approx(size, rel=0.35) and found.factor is None


@per_example
@given(seed=seeds, electrode=st.integers(0, 15))
def test_a_step_of_one_electrode_names_it(make_recording, seed, electrode):
    made = make_recording(presses=12, seed=seed)
    rows = np.flatnonzero((made.channels == electrode).any(axis=1))
    (found,) = steps(stepped(made, 40, 300.0, rows, seed))
    assert found.electrodes == (electrode,) and set(found.channels) <= set(rows.tolist())
    (finding,) = suspicions.steps_in_time(made)
    assert (
        f"electrode {electrode} takes part" in finding.sentence
        and "frame 40 on" in finding.sentence
    )
    assert finding.sentence.endswith("a contact moved.")
    made.frames["touch"] = False
    said = [finding.sentence for finding in suspicions.steps_in_time(made)]
    assert all(("moved" in one) == ("touch that the file does not tell" in one) for one in said)
    assert any("moved" in one for one in said)


@per_example
@given(seed=seeds, change=st.floats(0.01, 0.3), sign=st.sampled_from([-1, 1]))
def test_a_gain_that_is_switched_is_a_step_by_a_factor(make_recording, seed, change, sign):
    made = make_recording(presses=12, seed=seed)
    made.voltage[33:] *= 1.0 + sign * change
    (found,) = steps(made)
    assert found.between[0] < 33 <= found.between[1] and not found.electrodes
    assert found.factor == pytest.approx(1.0 + sign * change, rel=0.01)


def test_two_steps_are_two(make_recording):
    made = make_recording(presses=12)
    for frame in (20, 50):
        stepped(made, frame, 500.0, np.arange(208), frame)
    assert [one.frame for one in steps(made)] == [20, 50]


def test_another_session_and_differences_are_no_steps(make_recording):
    made = stepped(make_recording(presses=12), 40, 500.0, np.arange(208), 0)
    made.frames["session"] = np.where(made.frames["frame"] < 40, "before", "after")
    assert not steps(made)
    del made.frames["session"]
    assert len(steps(made)) == 1
    made.metadata["values"] = "difference"
    assert not steps(made)


@per_example
@given(seed=seeds, rho=st.sampled_from([0.0, 0.5, 0.9]), walk=st.sampled_from([0.0, 2e-3]))
def test_coloured_noise_walks_and_drift_are_no_steps(make_recording, seed, rho, walk):
    made = make_recording(presses=0, noise=0.0)
    draw = np.random.default_rng(seed)
    length, width = 200, made.voltage.shape[1]
    shape = made.voltage[0]
    made.frames = made.frames.iloc[[0] * length].reset_index(drop=True)
    made.frames["frame"], made.frames["time_s"] = np.arange(length), 0.5 * np.arange(length)
    noise = draw.standard_normal((length, width))
    for row in range(1, length):
        noise[row] = rho * noise[row - 1] + np.sqrt(1.0 - rho**2) * noise[row]
    gain = 1.0 + walk * np.cumsum(draw.standard_normal(length)) / np.sqrt(length)
    drift = 1.0 + np.linspace(0, 0.02, length)[:, None] * draw.standard_normal(width)
    made.voltage = shape * gain[:, None] * drift + 1e-3 * np.median(np.abs(shape)) * noise
    assert not steps(made)
