"""What is said of frames in which something is wrong, each fault after the same good start."""

from dataclasses import replace

import numpy as np
import pytest

import streamed_skin as skin
from eitskin.data.baseline import untouched_noise
from eitskin.errors import InputError
from eitskin.exported.predictor import Predictor
from eitskin.stream.judge import CANNOT_TELL, NO_TOUCH, STARTING, TOUCH, Judge
from streamed_verdicts import CASES, MOST_WRONG, told

PLACE = np.array([20.0, -10.0, 6.0])
NOTHING = np.zeros(3)
OPEN = np.isin(skin.TABLE[:, :2], 5).any(axis=1)
OF_5 = (skin.TABLE == 5).any(axis=1)


@pytest.fixture(scope="module")
def predictor():
    return Predictor(skin.exported())


def judged(predictor, states, spoil=lambda voltage: voltage, saturated=None, frame_s=0.05):
    """The verdicts of frames of states (N, 3), changed by `spoil`, after 10 good opening frames; a
    frame each `frame_s`."""
    draw = np.random.default_rng(4)
    judge, _ = opened(predictor, skin.readings(np.zeros((10, 3)), draw))
    voltage = spoil(skin.readings(np.asarray(states), draw))
    times = 0.5 + frame_s * np.arange(len(voltage))
    return [judge(*one, saturated) for one in zip(voltage, times, strict=True)], judge


def opened(predictor, opening):
    """A judge that has seen these frames, a frame each 50 ms, and what it said of them."""
    judge = Judge(predictor)
    return judge, [judge(one, 0.05 * number) for number, one in enumerate(opening)]


def of(verdicts):
    return [verdict.kind for verdict in verdicts]


def test_the_opening_then_no_touch_then_a_touch(predictor):
    _, opening = opened(predictor, skin.readings(np.zeros((10, 3)), np.random.default_rng(4)))
    assert of(opening) == [STARTING] * 9 + [NO_TOUCH]
    verdicts, _ = judged(predictor, [NOTHING] * 20 + [PLACE] * 20)
    assert of(verdicts).count(NO_TOUCH) >= 19
    touched = [v for v in verdicts[20:] if v.kind == TOUCH]
    assert len(touched) >= 18
    error = np.array([v.estimate.state - PLACE for v in touched])
    assert np.abs(error[:, :2]).max() < 10.0 and np.abs(error[:, 2]).max() < 2.0
    assert all((v.estimate.half > 0).all() for v in touched)


def test_the_intervals_hold_their_share(predictor):
    states = skin.touches(400, np.random.default_rng(8))
    verdicts, _ = judged(predictor, states)
    told_touches = [
        (v.estimate, s) for v, s in zip(verdicts, states, strict=True) if v.kind == TOUCH
    ]
    assert len(told_touches) > 340
    inside = np.mean([np.abs(e.state - s) <= e.half for e, s in told_touches], axis=0)
    assert (inside > 0.83).all() and (inside < 0.97).all()


def test_a_dead_electrode_is_named_and_the_interval_is_wider(predictor):
    def dead(voltage):
        spoilt = voltage.copy()
        spoilt[5:, OPEN] = 0.0
        spoilt[5:, OF_5 & ~OPEN] = 0.05
        return spoilt

    verdicts, judge = judged(predictor, [PLACE] * 30, dead)
    assert judge.lost == (5,)
    news = [words for v in verdicts for words in v.news]
    assert news == ["electrode 5 is lost; estimates are made without it"]
    assert of(verdicts[5:]).count(TOUCH) >= 24
    whole, without = verdicts[2].estimate, verdicts[-1].estimate
    assert (without.half >= whole.half).all() and (without.half > whole.half).any()
    assert np.abs(without.state - PLACE)[:2].max() < 15.0


def test_a_lost_electrode_that_is_mended_is_used_again(predictor):
    def dead_for_a_while(voltage):
        spoilt = voltage.copy()
        spoilt[:10, OF_5] = 0.0
        return spoilt

    states = [NOTHING] * 40 + [PLACE] * 20
    verdicts, judge = judged(predictor, states, dead_for_a_while)
    assert of(verdicts[:40]).count(NO_TOUCH) >= 38 and verdicts[39].lost == (5,)
    assert judge.lost == ()
    assert [w for v in verdicts for w in v.news][-1] == "electrode 5 is back"


def test_an_electrode_that_keeps_its_last_value_does_not_come_back(predictor):
    judge, _ = opened(predictor, skin.readings(np.zeros((10, 3)), np.random.default_rng(4)))
    judge.lose([5])
    draw = np.random.default_rng(5)
    for number, reading in enumerate(skin.readings(np.array([NOTHING, PLACE] * 30), draw)):
        frozen = np.where(OF_5, skin.level(), reading)
        verdict = judge(frozen, 0.5 + 0.05 * number)
    assert judge.lost == (5,) and verdict.kind == TOUCH


def test_an_electrode_that_is_dead_from_the_start_stays_so(predictor):
    draw = np.random.default_rng(4)
    states = np.array([NOTHING] * 50 + [PLACE] * 20)
    voltage = skin.readings(states, draw)
    voltage[:, OF_5] = 0.0
    judge, verdicts = opened(predictor, voltage)
    assert verdicts[9].news[0].startswith("electrode 5 is dead from the start")
    assert judge.lost == (5,) and not [w for v in verdicts[10:] for w in v.news]
    assert of(verdicts[10:50]).count(NO_TOUCH) >= 38
    assert of(verdicts[50:]).count(TOUCH) >= 18 and verdicts[-1].lost == (5,)


def test_a_quiet_board_s_readings_that_stand_still_are_no_dead_electrodes(predictor):
    step = 2.148e-3
    still = np.round(skin.readings(np.zeros((10, 3)), np.random.default_rng(4)) / step) * step
    still[:, :150] = still[0, :150]
    judge, _ = opened(predictor, still)
    assert judge.lost == ()


def test_a_channel_that_no_opening_frame_read_is_learned_later(predictor):
    voltage = skin.readings(np.zeros((30, 3)), np.random.default_rng(4))
    voltage[:10, 77] = np.nan
    judge, verdicts = opened(predictor, voltage)
    assert [v.left_out for v in verdicts[10:12]] == [1, 0]
    assert of(verdicts[10:]).count(NO_TOUCH) >= 19
    spiked = skin.readings(PLACE[None], np.random.default_rng(5))[0]
    spiked[77] += 0.3
    assert judge(spiked, 2.0).left_out == 1


@pytest.mark.parametrize(
    ("force", "said"),
    [
        (np.full(10, 3.0), "found a touch like those trained on"),
        (np.linspace(0.0, 6.0, 10), r"found frame \d unlike the others"),
    ],
    ids=["held", "moving"],
)
def test_an_opening_that_is_touched_is_refused(predictor, force, said):
    states = np.column_stack([np.full(10, 20.0), np.full(10, -10.0), force])
    with pytest.raises(InputError, match=said + ", expected an untouched skin"):
        opened(predictor, skin.readings(states, np.random.default_rng(4)))


def test_another_day_s_conductivity_is_no_touch(predictor):
    voltage = 1.06 * skin.readings(np.zeros((10, 3)), np.random.default_rng(4))
    assert opened(predictor, voltage)[1][-1].kind == NO_TOUCH


def test_one_in_a_hundred_untouched_frames_is_above_the_gate():
    draw = np.random.default_rng(4)
    still = skin.NOISE_V * draw.standard_normal((1000, 208))  # against a mean without noise
    noise, made = untouched_noise(still), skin.exported()
    exported = replace(made, header=made.header | {"touch": {"threshold": noise["quantile_99"]}})
    own = Predictor(exported)
    own.activity = lambda change: float(np.sqrt(np.mean((change / skin.NOISE_V) ** 2)))
    false = []
    for _ in range(6):
        judge, _ = opened(own, skin.readings(np.zeros((10, 3)), draw))
        voltage = skin.readings(np.zeros((50, 3)), draw)
        false += [judge(one, 0.5).kind != NO_TOUCH for one in voltage]
    assert np.mean(false) < 0.03


def test_three_dead_electrodes_are_refused(predictor):
    opening = skin.readings(np.zeros((10, 3)), np.random.default_rng(4))
    opening[:, np.isin(skin.TABLE, [2, 7, 12]).any(axis=1)] = np.nan
    with pytest.raises(InputError, match=r"found electrodes .* dead, expected 2 at most"):
        opened(predictor, opening)


def test_lost_readings_are_done_without(predictor):
    def lost(voltage):
        spoilt = voltage.copy()
        spoilt[:, 3::20] = np.nan
        return spoilt

    verdicts, _ = judged(predictor, [PLACE] * 20, lost)
    assert of(verdicts).count(TOUCH) >= 18 and {v.left_out for v in verdicts} == {11}


def test_what_is_missing_widens_the_interval(predictor):
    change = skin.dataset().delta_V[7].astype(float)
    change[3::20] = np.nan
    whole, missing = predictor.filled(change)
    assert (predictor.estimate(whole, missing).half > predictor.half[missing.class_number]).all()


def test_what_is_missing_beside_a_lost_electrode_widens_the_interval(predictor):
    change = skin.dataset().delta_V[7].astype(float)
    change[OF_5] = np.nan
    alone = predictor.estimate(*predictor.filled(change), (5,))
    change[3::20] = np.nan
    whole, missing = predictor.filled(change)
    assert (predictor.estimate(whole, missing, (5,)).half > alone.half).all()


def test_a_frame_of_lost_readings_cannot_be_told(predictor):
    verdicts, _ = judged(predictor, [PLACE] * 2, lambda voltage: np.full_like(voltage, np.nan))
    assert of(verdicts) == [CANNOT_TELL] * 2 and verdicts[0].why == "208 of 208 readings are lost"


def test_a_drift_that_is_no_gain_is_no_touch_or_cannot_be_told(predictor):
    slope = skin.level() * np.random.default_rng(6).normal(0.0, 1.0, 208) * 6e-5

    def drift(voltage):
        return voltage + slope * np.arange(len(voltage))[:, None]

    verdicts, _ = judged(predictor, [NOTHING] * 200, drift)
    assert set(of(verdicts[:30])) == {NO_TOUCH} and verdicts[-1].kind == CANNOT_TELL
    assert TOUCH not in of(verdicts)


def test_the_conductivity_s_drift_during_a_touch_is_known_after_it(predictor):
    def drift(voltage):
        return voltage * np.linspace(1.0, 1.02, len(voltage))[:, None]

    verdicts, _ = judged(predictor, [PLACE] * 100 + [NOTHING] * 20, drift, frame_s=1.0)
    assert of(verdicts[-20:]).count(NO_TOUCH) >= 18


def test_a_touch_that_is_held_stays_one(predictor):
    verdicts, _ = judged(predictor, [PLACE] * 200, frame_s=1.0)
    assert of(verdicts).count(TOUCH) >= 190


@pytest.mark.parametrize("case", CASES)
def test_a_wrong_thing_is_seldom_said_as_sure(predictor, case):
    shares = told(predictor, CASES[case])
    assert shares["wrong"] <= MOST_WRONG and shares["right"] >= CASES[case].least


def test_a_palm_is_a_palm_no_longer_than_the_drift_that_it_may_be(predictor):
    verdicts, _ = judged(predictor, [NOTHING] * 150, lambda voltage: 0.98 * voltage, frame_s=1.0)
    assert set(of(verdicts[:30])) == {CANNOT_TELL} and set(of(verdicts[70:])) == {NO_TOUCH}
    assert verdicts[0].why.startswith("all readings moved by -2.0 %, more than a drift of 2 %")


def test_a_spike_is_left_out(predictor):
    def spiked(voltage):
        spoilt = voltage.copy()
        spoilt[10, 77] += 0.3
        return spoilt

    for states, kind in (([PLACE] * 20, TOUCH), ([NOTHING] * 20, NO_TOUCH)):
        verdicts, judge = judged(predictor, states, spiked)
        assert verdicts[10].kind == kind and verdicts[10].left_out == 1
        assert judge.lost == ()


def test_saturated_readings(predictor):
    few, many = np.zeros((2, 208), dtype=bool)
    few[:20], many[:60] = True, True
    whole, _ = judged(predictor, [PLACE] * 10)
    verdicts, _ = judged(predictor, [PLACE] * 10, saturated=few)
    assert of(verdicts).count(TOUCH) >= 9 and verdicts[0].left_out == 20
    half, widened = (np.mean([v.estimate.half for v in of], axis=0) for of in (whole, verdicts))
    assert widened[2] > half[2]
    error = np.abs([v.estimate.state - PLACE for v in verdicts])
    assert (error <= [v.estimate.half for v in verdicts]).mean() > 0.7
    verdicts, _ = judged(predictor, [PLACE] * 2, saturated=many)
    assert of(verdicts) == [CANNOT_TELL] * 2
    assert verdicts[0].why == "60 of 208 readings are saturated or lost"


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
    verdicts, _ = judged(predictor, [PLACE] * 20, spoil)
    assert of(verdicts).count(CANNOT_TELL) >= 18
    assert verdicts[0].why == "unlike what the model was trained on"
