"""What is said of frames in which something is wrong, each fault after the same good start."""

import numpy as np
import pytest

import streamed_skin as skin
from eitskin.errors import InputError
from eitskin.exported.predictor import Predictor
from eitskin.stream.judge import CANNOT_TELL, NO_TOUCH, STARTING, TOUCH, Judge

PLACE = np.array([20.0, -10.0, 6.0])
NOTHING = np.zeros(3)
OPEN = np.isin(skin.TABLE[:, :2], 5).any(axis=1)
OF_5 = (skin.TABLE == 5).any(axis=1)


@pytest.fixture(scope="module")
def predictor():
    return Predictor(skin.exported())


def judged(predictor, states, spoil=lambda voltage: voltage, saturated=None):
    """The verdicts of frames of states (N, 3), changed by `spoil`, after 10 good opening frames."""
    draw = np.random.default_rng(4)
    judge = Judge(predictor)
    for reading in skin.readings(np.zeros((10, 3)), draw):
        judge(reading)
    voltage = spoil(skin.readings(np.asarray(states), draw))
    return [judge(one, None if saturated is None else saturated) for one in voltage], judge


def of(verdicts):
    return [verdict.kind for verdict in verdicts]


def test_the_opening_then_no_touch_then_a_touch(predictor):
    judge, draw = Judge(predictor), np.random.default_rng(4)
    opening = [judge(one) for one in skin.readings(np.zeros((10, 3)), draw)]
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
    told = [(v.estimate, s) for v, s in zip(verdicts, states, strict=True) if v.kind == TOUCH]
    assert len(told) > 380
    inside = np.mean([np.abs(e.state - s) <= e.half for e, s in told], axis=0)
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

    verdicts, judge = judged(predictor, [NOTHING] * 40, dead_for_a_while)
    assert of(verdicts).count(NO_TOUCH) >= 38
    assert judge.lost == ()
    assert [w for v in verdicts for w in v.news][-1] == "electrode 5 is back"


def test_an_electrode_that_is_dead_from_the_start(predictor):
    judge, draw = Judge(predictor), np.random.default_rng(4)
    opening = skin.readings(np.zeros((10, 3)), draw)
    opening[:, OPEN] = 0.0
    for reading in opening:
        verdict = judge(reading)
    assert judge.lost == (5,) and verdict.news == ("electrode 5 is dead from the start",)


def test_three_dead_electrodes_are_refused(predictor):
    judge, draw = Judge(predictor), np.random.default_rng(4)
    opening = skin.readings(np.zeros((10, 3)), draw)
    opening[:, np.isin(skin.TABLE, [2, 7, 12]).any(axis=1)] = np.nan
    with pytest.raises(InputError, match=r"found electrodes .* dead, expected 2 at most"):
        for reading in opening:
            judge(reading)


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
    assert (predictor.estimate(whole, missing).half > predictor.half[missing.number]).all()
    without = predictor.estimate(whole, missing, (5,)).half
    assert (without >= predictor.half[missing.number]).all()


def test_a_frame_of_lost_readings_cannot_be_told(predictor):
    verdicts, _ = judged(predictor, [PLACE] * 2, lambda voltage: np.full_like(voltage, np.nan))
    assert of(verdicts) == [CANNOT_TELL] * 2 and verdicts[0].why == "208 of 208 readings are lost"


def test_drift_is_followed_while_nobody_touches(predictor):
    slope = skin.level() * np.random.default_rng(6).normal(0.0, 1.0, 208) * 6e-5

    def drift(voltage):
        return voltage + slope * np.arange(len(voltage))[:, None]

    verdicts, _ = judged(predictor, [NOTHING] * 300 + [PLACE] * 3, drift)
    assert of(verdicts[:300]).count(NO_TOUCH) >= 290
    assert of(verdicts[300:]) == [TOUCH] * 3
    assert np.abs(verdicts[-1].estimate.state - PLACE)[:2].max() < 12.0


def test_the_conductivity_s_drift_during_a_touch_is_known_after_it(predictor):
    def drift(voltage):
        return voltage * np.linspace(1.0, 1.02, len(voltage))[:, None]

    verdicts, _ = judged(predictor, [PLACE] * 100 + [NOTHING] * 20, drift)
    assert of(verdicts[-20:]).count(NO_TOUCH) >= 18


def test_nobody_s_drift_is_followed_while_someone_touches(predictor):
    verdicts, _ = judged(predictor, [PLACE] * 200)
    assert of(verdicts).count(TOUCH) >= 190


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
    verdicts, _ = judged(predictor, [PLACE] * 10, saturated=few)
    assert of(verdicts).count(TOUCH) >= 9 and verdicts[0].left_out == 20
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
