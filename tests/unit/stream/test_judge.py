"""What is said of frames in which something is wrong, each fault after the same good start."""

from dataclasses import replace

import numpy as np
import pytest

import streamed_skin as skin
from eitskin.data.baseline import untouched_noise
from eitskin.errors import InputError
from eitskin.exported.predictor import Predictor
from eitskin.stream.judge import CANNOT_TELL, NO_TOUCH, STARTING, TOUCH, Judge
from streamed_verdicts import CASES, MOST_WRONG, verdict_shares

pytestmark = pytest.mark.xdist_group("streamed")  # one predictor, trained in seconds

PLACE = np.array([20.0, -10.0, 6.0])
NOTHING = np.zeros(3)
OPEN = np.isin(skin.TABLE[:, :2], 5).any(axis=1)
OF_5 = (skin.TABLE == 5).any(axis=1)


@pytest.fixture(scope="module")
def predictor():
    return Predictor(skin.exported())


def judge_states(predictor, states, spoil=lambda voltage: voltage, saturated=None, frame_s=0.05):
    """The verdicts of frames of states (N, 3), changed by `spoil`, after 10 good opening frames; a
    frame each `frame_s`."""
    draw = np.random.default_rng(4)
    judge, _ = judge_opening(predictor, skin.readings(np.zeros((10, 3)), draw))
    voltage = spoil(skin.readings(np.asarray(states), draw))
    times = 0.5 + frame_s * np.arange(len(voltage))
    return [judge(*frame, saturated) for frame in zip(voltage, times, strict=True)], judge


def judge_opening(predictor, opening):
    """A judge that has seen these frames, a frame each 50 ms, and what it said of them."""
    judge = Judge(predictor)
    return judge, [judge(reading, 0.05 * number) for number, reading in enumerate(opening)]


def verdict_kinds(verdicts):
    return [verdict.kind for verdict in verdicts]


def test_the_opening_then_no_touch_then_a_touch(predictor):
    _, opening = judge_opening(
        predictor, skin.readings(np.zeros((10, 3)), np.random.default_rng(4))
    )
    assert verdict_kinds(opening) == [STARTING] * 9 + [NO_TOUCH]
    verdicts, _ = judge_states(predictor, [NOTHING] * 20 + [PLACE] * 20)
    assert verdict_kinds(verdicts).count(NO_TOUCH) >= 19
    touched = [v for v in verdicts[20:] if v.kind == TOUCH]
    assert len(touched) >= 18
    error = np.array([v.estimate.state - PLACE for v in touched])
    assert np.abs(error[:, :2]).max() < 10.0 and np.abs(error[:, 2]).max() < 2.0
    assert all((v.estimate.half > 0).all() for v in touched)


def test_the_intervals_hold_their_share(predictor):
    states = skin.touches(400, np.random.default_rng(8))
    verdicts, _ = judge_states(predictor, states)
    touches = [(v.estimate, s) for v, s in zip(verdicts, states, strict=True) if v.kind == TOUCH]
    assert len(touches) > 340
    inside = np.mean([np.abs(e.state - s) <= e.half for e, s in touches], axis=0)
    assert (inside > 0.83).all() and (inside < 0.97).all()


def test_a_dead_electrode_is_named_and_the_interval_is_wider(predictor):
    def dead(voltage):
        faulty = voltage.copy()
        faulty[5:, OPEN] = 0.0
        faulty[5:, OF_5 & ~OPEN] = 0.05
        return faulty

    verdicts, judge = judge_states(predictor, [PLACE] * 30, dead)
    assert judge.lost_electrodes == (5,)
    news = [words for v in verdicts for words in v.notices]
    assert news == ["electrode 5 is lost; estimates are made without it"]
    assert verdict_kinds(verdicts[5:]).count(TOUCH) >= 24
    estimate_before, estimate_after = verdicts[2].estimate, verdicts[-1].estimate
    assert (estimate_after.half >= estimate_before.half).all() and (
        estimate_after.half > estimate_before.half
    ).any()
    assert np.abs(estimate_after.state - PLACE)[:2].max() < 15.0


def test_a_lost_electrode_that_is_mended_is_used_again(predictor):
    def dead_for_a_while(voltage):
        faulty = voltage.copy()
        faulty[:10, OF_5] = 0.0
        return faulty

    states = [NOTHING] * 40 + [PLACE] * 20
    verdicts, judge = judge_states(predictor, states, dead_for_a_while)
    assert verdict_kinds(verdicts[:40]).count(NO_TOUCH) >= 38 and verdicts[39].lost_electrodes == (
        5,
    )
    assert judge.lost_electrodes == ()
    assert [w for v in verdicts for w in v.notices][-1] == "electrode 5 is back"


def test_an_electrode_that_keeps_its_last_value_does_not_come_back(predictor):
    judge, _ = judge_opening(predictor, skin.readings(np.zeros((10, 3)), np.random.default_rng(4)))
    judge.set_lost_electrodes([5])
    draw = np.random.default_rng(5)
    for number, reading in enumerate(skin.readings(np.array([NOTHING, PLACE] * 30), draw)):
        frozen = np.where(OF_5, skin.level(), reading)
        verdict = judge(frozen, 0.5 + 0.05 * number)
    assert judge.lost_electrodes == (5,) and verdict.kind == TOUCH


def test_an_electrode_that_is_dead_from_the_start_stays_so(predictor):
    draw = np.random.default_rng(4)
    states = np.array([NOTHING] * 50 + [PLACE] * 20)
    voltage = skin.readings(states, draw)
    voltage[:, OF_5] = 0.0
    judge, verdicts = judge_opening(predictor, voltage)
    assert verdicts[9].notices[0].startswith("electrode 5 is dead from the start")
    assert judge.lost_electrodes == (5,) and not [w for v in verdicts[10:] for w in v.notices]
    assert verdict_kinds(verdicts[10:50]).count(NO_TOUCH) >= 38
    assert verdict_kinds(verdicts[50:]).count(TOUCH) >= 18 and verdicts[-1].lost_electrodes == (5,)


def test_a_quiet_board_s_readings_that_stand_still_are_no_dead_electrodes(predictor):
    step = 2.148e-3
    quantised = np.round(skin.readings(np.zeros((10, 3)), np.random.default_rng(4)) / step) * step
    quantised[:, :150] = quantised[0, :150]
    judge, _ = judge_opening(predictor, quantised)
    assert judge.lost_electrodes == ()


def test_a_channel_that_no_opening_frame_read_is_learned_later(predictor):
    voltage = skin.readings(np.zeros((30, 3)), np.random.default_rng(4))
    voltage[:10, 77] = np.nan
    judge, verdicts = judge_opening(predictor, voltage)
    assert [v.n_missing for v in verdicts[10:12]] == [1, 0]
    assert verdict_kinds(verdicts[10:]).count(NO_TOUCH) >= 19
    spiked = skin.readings(PLACE[None], np.random.default_rng(5))[0]
    spiked[77] += 0.3
    assert judge(spiked, 2.0).n_missing == 1


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (np.full(10, 3.0), "found a touch like those trained on"),
        (np.linspace(0.0, 6.0, 10), r"found frame \d unlike the others"),
    ],
    ids=["held", "moving"],
)
def test_an_opening_that_is_touched_is_refused(predictor, force, message):
    states = np.column_stack([np.full(10, 20.0), np.full(10, -10.0), force])
    with pytest.raises(InputError, match=message + ", expected an untouched skin"):
        judge_opening(predictor, skin.readings(states, np.random.default_rng(4)))


def test_another_day_s_conductivity_is_no_touch(predictor):
    voltage = 1.06 * skin.readings(np.zeros((10, 3)), np.random.default_rng(4))
    assert judge_opening(predictor, voltage)[1][-1].kind == NO_TOUCH


def test_one_in_a_hundred_untouched_frames_is_above_the_gate():
    draw = np.random.default_rng(4)
    untouched_changes = skin.NOISE_V * draw.standard_normal(
        (1000, 208)
    )  # against a mean without noise
    noise, streamed = untouched_noise(untouched_changes), skin.exported()
    exported = replace(
        streamed, header=streamed.header | {"touch": {"threshold": noise["quantile_99"]}}
    )
    gated_predictor = Predictor(exported)
    gated_predictor.activity = lambda change: float(np.sqrt(np.mean((change / skin.NOISE_V) ** 2)))
    false_alarms = []
    for _ in range(6):
        judge, _ = judge_opening(gated_predictor, skin.readings(np.zeros((10, 3)), draw))
        voltage = skin.readings(np.zeros((50, 3)), draw)
        false_alarms += [judge(reading, 0.5).kind != NO_TOUCH for reading in voltage]
    assert np.mean(false_alarms) < 0.03


def test_three_dead_electrodes_are_refused(predictor):
    opening = skin.readings(np.zeros((10, 3)), np.random.default_rng(4))
    opening[:, np.isin(skin.TABLE, [2, 7, 12]).any(axis=1)] = np.nan
    with pytest.raises(InputError, match=r"found electrodes .* dead, expected 2 at most"):
        judge_opening(predictor, opening)


def test_lost_readings_are_done_without(predictor):
    def lost(voltage):
        faulty = voltage.copy()
        faulty[:, 3::20] = np.nan
        return faulty

    verdicts, _ = judge_states(predictor, [PLACE] * 20, lost)
    assert verdict_kinds(verdicts).count(TOUCH) >= 18 and {v.n_missing for v in verdicts} == {11}


def test_what_is_missing_widens_the_interval(predictor):
    change = skin.dataset().delta_V[7].astype(float)
    change[3::20] = np.nan
    imputed, missing = predictor.filled(change)
    assert (predictor.estimate(imputed, missing).half > predictor.half[missing.class_number]).all()


def test_what_is_missing_beside_a_lost_electrode_widens_the_interval(predictor):
    change = skin.dataset().delta_V[7].astype(float)
    change[OF_5] = np.nan
    without_electrode = predictor.estimate(*predictor.filled(change), (5,))
    change[3::20] = np.nan
    imputed, missing = predictor.filled(change)
    assert (predictor.estimate(imputed, missing, (5,)).half > without_electrode.half).all()


def test_a_frame_of_lost_readings_cannot_be_told(predictor):
    verdicts, _ = judge_states(
        predictor, [PLACE] * 2, lambda voltage: np.full_like(voltage, np.nan)
    )
    assert (
        verdict_kinds(verdicts) == [CANNOT_TELL] * 2
        and verdicts[0].reason == "208 of 208 readings are lost"
    )


def test_a_drift_that_is_no_gain_is_no_touch_or_cannot_be_told(predictor):
    slope = skin.level() * np.random.default_rng(6).normal(0.0, 1.0, 208) * 6e-5

    def drift(voltage):
        return voltage + slope * np.arange(len(voltage))[:, None]

    verdicts, _ = judge_states(predictor, [NOTHING] * 200, drift)
    assert set(verdict_kinds(verdicts[:30])) == {NO_TOUCH} and verdicts[-1].kind == CANNOT_TELL
    assert TOUCH not in verdict_kinds(verdicts)


def test_the_conductivity_s_drift_during_a_touch_is_known_after_it(predictor):
    def drift(voltage):
        return voltage * np.linspace(1.0, 1.02, len(voltage))[:, None]

    verdicts, _ = judge_states(predictor, [PLACE] * 100 + [NOTHING] * 20, drift, frame_s=1.0)
    assert verdict_kinds(verdicts[-20:]).count(NO_TOUCH) >= 18


def test_a_touch_that_is_held_stays_one(predictor):
    verdicts, _ = judge_states(predictor, [PLACE] * 200, frame_s=1.0)
    assert verdict_kinds(verdicts).count(TOUCH) >= 190


@pytest.mark.parametrize("case", CASES)
def test_a_wrong_thing_is_seldom_said_as_sure(predictor, case):
    shares = verdict_shares(predictor, CASES[case])
    assert shares["wrong"] <= MOST_WRONG and shares["right"] >= CASES[case].least_right_share


def test_a_palm_is_a_palm_no_longer_than_the_drift_that_it_may_be(predictor):
    verdicts, _ = judge_states(
        predictor, [NOTHING] * 150, lambda voltage: 0.98 * voltage, frame_s=1.0
    )
    assert set(verdict_kinds(verdicts[:30])) == {CANNOT_TELL} and set(
        verdict_kinds(verdicts[70:])
    ) == {NO_TOUCH}
    assert verdicts[0].reason.startswith("all readings moved by -2.0 %, more than a drift of 2 %")


def test_a_spike_is_left_out(predictor):
    def spiked(voltage):
        faulty = voltage.copy()
        faulty[10, 77] += 0.3
        return faulty

    for states, kind in (([PLACE] * 20, TOUCH), ([NOTHING] * 20, NO_TOUCH)):
        verdicts, judge = judge_states(predictor, states, spiked)
        assert verdicts[10].kind == kind and verdicts[10].n_missing == 1
        assert judge.lost_electrodes == ()


def test_saturated_readings(predictor):
    few_saturated, many_saturated = np.zeros((2, 208), dtype=bool)
    few_saturated[:20], many_saturated[:60] = True, True
    unsaturated_verdicts, _ = judge_states(predictor, [PLACE] * 10)
    saturated_verdicts, _ = judge_states(predictor, [PLACE] * 10, saturated=few_saturated)
    assert (
        verdict_kinds(saturated_verdicts).count(TOUCH) >= 9
        and saturated_verdicts[0].n_missing == 20
    )
    half_widths = [
        np.mean([v.estimate.half for v in verdicts], axis=0)
        for verdicts in (unsaturated_verdicts, saturated_verdicts)
    ]
    assert half_widths[1][2] > half_widths[0][2]
    error = np.abs([v.estimate.state - PLACE for v in saturated_verdicts])
    assert (error <= [v.estimate.half for v in saturated_verdicts]).mean() > 0.7
    saturated_verdicts, _ = judge_states(predictor, [PLACE] * 2, saturated=many_saturated)
    assert verdict_kinds(saturated_verdicts) == [CANNOT_TELL] * 2
    assert saturated_verdicts[0].reason == "60 of 208 readings are saturated or lost"


@pytest.mark.parametrize(
    "spoil",
    [
        lambda v: 2 * skin.level() - v,
        lambda v: skin.level() + 5 * (v - skin.level()),
        lambda v: skin.level() + np.random.default_rng(1).permuted(v - skin.level(), axis=1),
    ],
    ids=["sign", "gain", "shuffled"],
)
def test_what_no_touch_looks_like_cannot_be_told(predictor, spoil):
    verdicts, _ = judge_states(predictor, [PLACE] * 20, spoil)
    assert verdict_kinds(verdicts).count(CANNOT_TELL) >= 18
    assert verdicts[0].reason == "unlike what the model was trained on"
