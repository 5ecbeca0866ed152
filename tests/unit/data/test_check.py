import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eitskin.data import check, importers
from eitskin.data.channel_order import known_orders
from eitskin.data.check import ERROR, FACT, UNOBSERVABLE, WARNING, measures, sentences, wiring
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table, reciprocal_channels
from eitskin.quantities import decimal, percent
from shared_data import shared_data

FROM_OWN = "drive-plus-ascending-own"


def topics(recording, severity):
    return {
        finding.topic for finding in check.check(recording).findings if finding.severity == severity
    }


def value(recording, topic):
    (finding,) = check.check(recording).of_topic(topic)
    return finding.value


def test_a_good_recording_is_usable_and_says_what_it_holds(make_recording):
    result = check.check(make_recording(presses=30))
    report_text = check.text(result)
    assert result.ok and report_text.endswith("Usable.\n")
    assert "165 frames: 45 untouched, 120 touched in 30 presses at 30 places" in report_text
    assert "208 of 16 electrodes, adjacent drive, adjacent measurement" in report_text
    assert "1 to 8 N, 3 different" in report_text
    assert not {finding.severity for finding in result.findings} & {WARNING, ERROR}


def test_a_query_is_only_described(make_recording):
    query = make_recording()
    query.voltage = None
    report_text = check.text(check.check(query))
    assert "a query of 165 frames" in report_text and "noise" not in report_text


@pytest.mark.parametrize("noise", [1e-4, 1e-2])
def test_noise_is_measured_through_drift(make_recording, noise):
    recording = make_recording(noise=noise)
    level = np.median(np.abs(recording.voltage[~recording.frames["touch"]]))
    recording.voltage *= 1.0 + 1e-5 * recording.frames[["time_s"]].to_numpy()
    assert value(recording, "noise") == pytest.approx(noise * level, rel=0.15)


def test_without_repeats_reciprocity_bounds_the_noise(make_recording):
    recording = make_recording(presses=0, noise=1e-2)
    level = np.median(np.abs(recording.voltage))
    recording.frames, recording.voltage = recording.frames[:1], recording.voltage[:1]
    (finding,) = sentences.noise(recording)
    assert "at most" in finding.sentence
    assert finding.value == pytest.approx(1e-2 * level, rel=0.3)


def test_drift_is_told_and_whether_one_factor_explains_it(make_recording):
    recording = make_recording(noise=1e-5)
    slope = recording.frames["time_s"].to_numpy() / recording.frames["time_s"].max()
    recording.voltage *= 1.0 + 0.1 * slope[:, None]
    (finding,) = sentences.drift(recording)
    assert finding.value == pytest.approx(0.1, abs=0.01)
    assert finding.sentence.endswith("nearly all of it by one factor in all channels.")
    factors = np.random.default_rng(0).normal(0, 0.1, recording.voltage.shape[1])
    recording.voltage *= 1.0 + slope[:, None] * factors
    assert sentences.drift(recording)[0].sentence.endswith("each channel in its own way.")


def test_reciprocity_error_is_the_median_relative_difference(make_recording):
    recording = make_recording(presses=0, noise=0.0)
    assert value(recording, "reciprocity") < 1e-12
    first_half = recording.channels[:, 0] < recording.channels[:, 2]
    recording.voltage[:, first_half] *= 1.05
    assert value(recording, "reciprocity") == pytest.approx(0.05 / 1.025)


def test_one_of_a_thing_is_no_plural(make_recording):
    recording = make_recording(presses=1)
    assert "in 1 press at 1 place;" in "".join(
        f.sentence for f in check.check(recording).of_topic("frames")
    )
    probe, *_ = check.check(recording).of_topic("probe")
    assert probe.severity == FACT
    assert probe.sentence.endswith(" mm always.") and "different" not in probe.sentence


def test_readings_whose_squares_vanish_have_no_reciprocity(make_recording):
    recording = make_recording(presses=0)
    recording.voltage *= 1e-170
    assert sentences.reciprocity(recording) == []


def test_a_lead_that_all_lost_channels_share_is_named(make_recording):
    recording = make_recording()
    recording.voltage[:, (recording.channels[:, 2:] == 5).any(axis=1)] = np.nan
    (lost,) = check.check(recording).of_topic("lost")
    assert lost.sentence.endswith(
        "lost in every frame: all that electrode 5 measures; look at its lead."
    )


def test_lost_stuck_and_clipped_channels_are_named(make_recording):
    recording = make_recording()
    recording.voltage[:, 5] = np.nan
    recording.voltage[::3, 9] = np.nan
    recording.voltage[:, 20] = 0.01
    report_text = check.text(check.check(recording))
    assert "1 channel (5: drive 0-1, measured 7-8) lost in every frame" in report_text
    assert (
        "1 channel (9: drive 0-1, measured 11-12) lost in some frames (33.3 % of them)"
        in report_text
    )
    assert "1 channel (20: drive 1-2, measured 10-11) never change" in report_text
    ceiling = 0.95 * np.nanmax(np.abs(recording.voltage))
    recording.voltage = np.clip(recording.voltage, -ceiling, ceiling)
    at_ceiling = (np.abs(recording.voltage) == ceiling).any(axis=0).sum()
    assert value(recording, "clipped") == pytest.approx(at_ceiling / 208)
    assert topics(recording, WARNING) >= {"lost", "stuck", "clipped"}


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_whole_steps_and_still_frames_are_not_called_clipped(make_recording, noise):
    recording = make_recording(noise=noise)
    assert value(recording, "clipped") == 0.0
    step = 2e-3 * np.abs(recording.voltage).max()
    recording.voltage = step * np.round(recording.voltage / step)
    assert value(recording, "clipped") == 0.0


def untouched(recording):
    return ~recording.frames["touch"].to_numpy()


@pytest.mark.parametrize(
    ("spoil", "live"),
    [
        (lambda recording: recording.voltage.fill(0.0), 0),
        (lambda recording: recording.voltage.__setitem__(untouched(recording), 0.0), 0),
        (lambda recording: recording.voltage.__setitem__(untouched(recording), np.nan), 0),
        (lambda recording: recording.voltage.__setitem__(~untouched(recording), np.nan), 0),
        (lambda recording: recording.voltage.__setitem__((slice(None), slice(1, None)), np.nan), 1),
        (lambda recording: recording.voltage.__setitem__((slice(1, None)), np.nan), 0),
    ],
)
def test_a_recording_without_readings_is_unusable_and_says_why(make_recording, spoil, live):
    recording = make_recording(presses=3)
    spoil(recording)
    result = check.check(recording)
    (finding,) = result.of_topic("dead")
    assert not result.ok and finding.severity == ERROR and finding.value == live
    assert f"{live} of 208 channels have a reading other than 0" in check.text(result)


def test_a_channel_that_stands_twice_is_a_warning_a_table_of_one_channel_an_error(make_recording):
    recording = make_recording()
    assert not check.check(recording).of_topic("repeated")
    recording.metadata["channels"][5] = recording.metadata["channels"][4]
    (finding,) = sentences.repeated_channels(recording)
    assert finding.severity == WARNING and finding.value == pytest.approx(1 / 208)
    assert "a channel appears twice: 1 channel (5: drive 0-1, measured 6-7)" in finding.sentence
    recording.metadata["channels"] = [recording.metadata["channels"][0]] * 208
    assert "repeated" in topics(recording, ERROR)
    assert "a channel appears twice: 207 channels" in check.text(check.check(recording))


@pytest.mark.filterwarnings("error")
@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_pattern_of_lost_and_empty_readings_stops_the_check(make_recording, data):
    """Rows, columns and single readings lost or 0, of any kind of recording."""
    pattern = data.draw(st.sampled_from(["adjacent", "opposite", "skip-2"]))
    presses = data.draw(st.sampled_from([0, 3]))
    recording = make_recording(channel_table(8, pattern), presses=presses, n_electrodes=8)
    draw = np.random.default_rng(data.draw(st.integers(0, 99)))
    for value in (np.nan, 0.0):
        for axis in (0, 1):
            gone = draw.random(recording.voltage.shape[axis]) < data.draw(
                st.sampled_from([0, 0.5, 0.98])
            )
            recording.voltage[gone if axis == 0 else (slice(None), gone)] = value
        recording.voltage[
            draw.random(recording.voltage.shape) < data.draw(st.sampled_from([0, 0.5]))
        ] = value
    for key, choices in (
        ("values", ["absolute", "difference"]),
        ("voltage", ["signed", "magnitude"]),
    ):
        recording.metadata[key] = data.draw(st.sampled_from(choices))
    if recording.metadata["voltage"] == "magnitude":
        recording.voltage = np.abs(recording.voltage)
    result = check.check(recording)
    assert check.text(result).endswith("Usable.\n") == result.ok


def test_the_check_of_an_unusable_recording_is_not_written(make_recording, tmp_path):
    recording, path = make_recording(), tmp_path / "skin.check.txt"
    check.write(check.check(recording), path, "skin.parquet")
    assert path.read_text(encoding="utf-8") == check.text(check.check(recording))
    path.unlink()
    disordered(recording, FROM_OWN)
    with pytest.raises(
        InputError, match=r"skin\.parquet: check, order: found wrong channel"
    ) as degrees:
        check.write(check.check(recording), path, "skin.parquet")
    assert degrees.value.__notes__ == [check.text(check.check(recording))]
    assert "\n" not in str(degrees.value) and not list(tmp_path.iterdir())


def disordered(recording, name):
    """The readings as they would stand in the file if they had been read in another order."""
    permutation = known_orders(recording.channels, recording.n_electrodes)[name]
    recording.voltage = recording.voltage[:, permutation]
    return recording


@pytest.mark.parametrize("signed", [True, False])
@pytest.mark.parametrize("drive", ["adjacent", "opposite", "skip-2"])
def test_a_wrong_order_is_an_error_and_named(make_recording, drive, signed):
    recording = make_recording(channel_table(16, drive), noise=5e-3)
    if not signed:
        recording.voltage = np.abs(recording.voltage)
        recording.metadata["voltage"] = "magnitude"
    assert check.check(recording).ok
    result = check.check(disordered(recording, FROM_OWN))
    assert not result.ok
    (finding,) = result.of_topic("order")
    assert finding.severity == ERROR and finding.value > wiring.DOUBTFUL_MISFIT
    assert finding.sentence.startswith("wrong channel order") and FROM_OWN in finding.sentence
    assert check.text(result).endswith("Not usable as it stands.\n")


def test_an_order_that_only_touches_betray(make_recording):
    """Reversing each drive's pairs leaves an even untouched skin as it is."""
    from_own = channel_table(16)[known_orders(channel_table(16), 16)[FROM_OWN]]
    recording = make_recording(from_own, presses=30, noise=1e-4)
    recording = disordered(recording, FROM_OWN.replace("ascending", "descending"))
    (untouched,) = sentences.reciprocity(recording)
    assert untouched.value < 1e-3
    (finding,) = sentences.channel_order(recording)
    assert finding.severity == ERROR and "wrong channel order" in finding.sentence


def test_readings_too_few_for_another_order_do_not_stop_the_check(make_recording):
    recording = make_recording(presses=0)
    pairs, _ = reciprocal_channels(recording.channels)
    lost = np.ones(208, dtype=bool)
    lost[[*pairs[5], *pairs[40]]] = False
    recording.voltage[:, lost] = np.nan
    (finding,) = check.check(recording).of_topic("order")
    assert finding.severity == FACT


def test_readings_that_no_order_repairs_are_unusable(make_recording):
    recording = make_recording(presses=0)
    recording.voltage = recording.voltage[:, np.random.default_rng(0).permutation(208)]
    (finding,) = check.check(recording).of_topic("order")
    assert finding.severity == ERROR and "no known channel order repairs it" in finding.sentence


def test_opposite_drive_that_breaks_reversal_is_not_called_a_wrong_order(make_recording):
    recording = make_recording(channel_table(16, "opposite"), presses=0)
    one_sided = (recording.channels[:, 2] - recording.channels[:, 0]) % 16
    recording.voltage *= 1.0 + 3.0 * np.exp(-one_sided / 4.0)
    (finding,) = check.check(recording).of_topic("order")
    assert finding.severity == WARNING and "the skin or the instrument" in finding.sentence


def test_exchanged_plus_and_minus_are_an_error(make_recording):
    recording = make_recording()
    assert not check.check(recording).of_topic("polarity")
    recording.metadata["channels"] = recording.channels[:, [0, 1, 3, 2]].tolist()
    assert topics(recording, ERROR) == {"polarity"}


def test_electrodes_numbered_the_other_way_or_from_another_are_an_error(make_recording):
    recording = make_recording(presses=40)
    assert abs(value(recording, "numbering")) < 2.0
    recording.frames["y_mm"] *= -1.0
    (finding,) = check.check(recording).of_topic("numbering")
    assert finding.severity == ERROR and "the other way round" in finding.sentence
    assert "clockwise, or mirror" in finding.sentence
    recording.frames["y_mm"] *= -1.0
    recording.metadata["skin"]["electrode_deg"] = [22.5 * (k + 1) for k in range(16)]
    (finding,) = check.check(recording).of_topic("numbering")
    assert finding.severity == ERROR and "off by +1.0 electrodes" in finding.sentence
    degrees = re.search(r"with about (\d+) degrees less each", finding.sentence)
    assert degrees is not None
    recording.metadata["skin"]["electrode_deg"] = [
        22.5 * (k + 1) - int(degrees[1]) for k in range(16)
    ]
    assert abs(value(recording, "numbering")) < 2.0


def test_no_sentence_of_a_clean_recording_has_a_signed_nothing_or_a_share_of_nothing(
    make_recording,
):
    texts = [f.sentence for f in check.check(make_recording(presses=40)).findings]
    assert not [s for s in texts if re.search(r"[-+\u2212]0 degrees|\b0(\.0+)? %|\b1 frames", s)]


def test_a_drift_that_noise_makes_is_called_noise_and_coarse_digits_give_a_bound(make_recording):
    recording = make_recording(presses=2, noise=1e-3)
    assert sentences.drift(recording)[0].sentence.endswith("no more than by their noise.")
    recording.voltage = np.round(recording.voltage, 1)
    recording.metadata["unit"] = "V"
    assert measures.noise(recording).sigma == 0.0
    (finding,) = sentences.noise(recording)
    assert "less than 100" in finding.sentence and "mV in the median" in finding.sentence


@pytest.mark.parametrize(
    ("share", "decimals", "text"),
    [(0.0, 2, "0.00 %"), (4e-5, 2, "less than 0.005 %"), (4e-5, 3, "0.004 %"), (-0.004, 0, "less")],
)
def test_a_share_that_is_not_nothing_is_never_said_to_be(share, decimals, text):
    assert percent(share, decimals).startswith(text)


def test_a_number_that_rounds_to_nothing_has_no_sign():
    assert [decimal(v, 1, sign=True) for v in (-0.04, 0.04, 1.26, -2.0)] == [
        "0.0",
        "0.0",
        "+1.3",
        "\u22122.0",
    ]


def test_a_skin_that_is_no_disc_is_not_called_usable_without_saying_for_what(make_recording):
    recording = make_recording()
    recording.metadata["skin"]["outline"] = "a hand"
    last_line = check.text(check.check(recording)).splitlines()[-1]
    assert last_line == "Usable to be compared with another recording, not to be diagnosed."


def test_what_a_full_recording_can_tell_is_not_listed(make_recording):
    recording = make_recording(presses=4)
    recording.metadata["frame_s"] = 0.35
    probe = recording.frames["x_mm"].to_numpy() > 0
    recording.frames.loc[recording.frames["touch"] & probe, "probe_mm"] = 15.0
    assert topics(recording, UNOBSERVABLE) == {"relaxation", "repeatability"}
    touched = np.flatnonzero(recording.frames["touch"])
    first_half = recording.frames.loc[touched[0], ["x_mm", "y_mm"]].to_numpy(dtype=float)
    recording.frames.loc[touched[-4:], ["x_mm", "y_mm"]] = first_half
    assert topics(recording, UNOBSERVABLE) == {"relaxation"}
    recording.frames["time_s"] *= 20.0
    recording.frames.loc[touched[:2], "force_N"] = 4.0
    assert topics(recording, UNOBSERVABLE) == set()


def test_what_a_poor_recording_cannot_tell_is_listed_with_what_to_add(make_recording):
    recording = make_recording(channel_table(16, "opposite"), presses=6)
    recording.metadata |= {"clock": "index", "unit": "arbitrary", "position_frame": "robot"}
    recording.voltage = np.abs(recording.voltage)
    recording.metadata["voltage"] = "magnitude"
    recording.frames.loc[recording.frames["touch"], ["force_N", "probe_mm"]] = np.nan
    unobservable_findings = topics(recording, UNOBSERVABLE)
    assert unobservable_findings == {
        *("rates", "scan", "sign", "conductivity", "reciprocity", "force", "probe"),
        *("relaxation", "hysteresis", "repeatability", "placement"),
    }
    findings = check.check(recording).findings
    assert all(finding.remedy for finding in findings if finding.severity == UNOBSERVABLE)
    assert "Add: a load cell's readings." in check.text(check.check(recording))


def test_one_untouched_frame_tells_neither_noise_nor_drift_nor_touch(make_recording):
    recording = make_recording(presses=0)
    recording.frames, recording.voltage = recording.frames[:1], recording.voltage[:1]
    assert topics(recording, UNOBSERVABLE) >= {"noise", "drift", "touch"}


def test_sessions_without_untouched_frames_do_not_stop_the_check(make_recording):
    recording = make_recording()
    touch = recording.frames["touch"]
    recording.frames["session"] = np.where(touch, "pressed", "free")
    assert "frames" in topics(recording, FACT)


@pytest.mark.parametrize("n", [8, 16])
def test_differences_that_are_stated_as_absolute_are_told(make_recording, n):
    recording = make_recording(presses=4, noise=1e-6, n_electrodes=n)
    recording.voltage -= recording.voltage[untouched(recording)].mean(axis=0)
    (finding,) = check.check(recording).of_severity(ERROR)
    assert finding.topic == "values" and finding.sentence.endswith("State values: difference.")


@pytest.mark.parametrize("normalised", [False, True])
@pytest.mark.parametrize("n", [8, 16])
def test_normalised_differences_are_told(make_recording, normalised, n):
    recording = make_recording(presses=4, noise=1e-6, n_electrodes=n)
    still = recording.voltage[untouched(recording)].mean(axis=0)
    recording.voltage = (recording.voltage - still) / (np.abs(still) if normalised else 1.0)
    recording.metadata["values"] = "difference"
    findings = check.check(recording).of_topic("values")
    assert ["are normalised" in finding.sentence for finding in findings] == [True] * normalised


def test_no_numbering_is_told_by_channels_in_a_wrong_order(make_recording):
    recording = disordered(make_recording(presses=6), "drive-plus-ascending-own")
    result = check.check(recording)
    assert result.of_topic("order")[0].severity == ERROR and not result.of_topic("numbering")


def test_a_broken_real_recording_is_unusable():
    folder = shared_data("pyeidors-tank/measurements/EIT_DEV_Test")
    (path,) = folder.glob("*Hz.csv")
    result = check.check(importers.load(path))
    assert not result.ok
    (finding,) = result.of_topic("order")
    assert "no known channel order repairs it" in finding.sentence
    assert finding.value == pytest.approx(0.42, abs=0.01)


def test_the_real_hydrogel_skin_breaks_reversal_but_not_its_order():
    result = check.check(importers.load(shared_data("hydrogel-skin/ohmc16.mat")))
    assert result.ok
    (order,) = result.of_topic("order")
    assert order.severity == WARNING and "by 1.14 and" in order.sentence
    (drift,) = result.of_topic("drift")
    assert drift.value == pytest.approx(0.115, abs=0.001)


@pytest.mark.parametrize(
    "name", ["hydrogel-skin/ohmc8.mat", "patterned-skin/inp_noPattern.csv", "lct-tank/homogeneous"]
)
def test_other_real_recordings_are_usable(name):
    assert check.check(importers.load(shared_data(name))).ok
