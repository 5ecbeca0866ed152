"""Which of the reserved readings measure nothing, told without any simulation."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.data.subset import of_frames
from eitskin.diagnose.fitting.held_out import draw_reserve_mask
from eitskin.diagnose.fitting.reserve_outliers import reserve_outliers
from small_skin import small_recording

NOISE = 1e-3
GAINS = {"name": "measurement-gain", "measures": [2], "parameters": {"gain": 1.05}}


def drawn(places, *items):
    recorded = small_recording(*items, noise=NOISE, places=max(places, 1))
    if not places:
        recorded = of_frames(recorded, ~recorded.frames["touch"].to_numpy(bool))
    return recorded, draw_reserve_mask(recorded, 1)


@pytest.mark.parametrize("places", [0, 10])
@pytest.mark.parametrize("items", [(), (GAINS,)])
def test_ordinary_readings_are_kept(places, items):
    recorded, kept = drawn(places, *items)
    assert kept.any() and not reserve_outliers(recorded, kept, None).any()


def test_a_spike_goes_with_its_reciprocal_and_a_loud_frame_whole():
    recorded, kept = drawn(10)
    first, second, *_ = np.flatnonzero(kept.any(axis=1))
    size = NOISE * np.median(np.abs(recorded.voltage))
    voltage = recorded.voltage.copy()
    voltage[first, 7] += 40.0 * size
    voltage[second] += 8.0 * size * np.random.default_rng(5).normal(size=voltage.shape[1])
    outliers = reserve_outliers(replace(recorded, voltage=voltage), kept, None)
    assert outliers[first, 7] and outliers[first].sum() == 2 and outliers[second].all()
    assert outliers.sum() == 2 + voltage.shape[1]


def test_readings_that_decide_are_none_of_them():
    recorded, kept = drawn(10)
    row = np.flatnonzero(~kept.any(axis=1))[-1]
    voltage = recorded.voltage.copy()
    voltage[row] *= 1.0 + 0.5 * np.random.default_rng(5).normal(size=voltage.shape[1])
    assert not reserve_outliers(replace(recorded, voltage=voltage), kept, None).any()


def test_of_what_has_no_reciprocal_none_is_rejected():
    recorded, kept = drawn(10)
    source, plus = recorded.channels[:, 0], recorded.channels[:, 2]
    half = source < plus
    metadata = recorded.metadata | {"channels": recorded.channels[half].tolist()}
    fewer = replace(recorded, voltage=1e3 * recorded.voltage[:, half], metadata=metadata)
    assert len(fewer.channels) == half.sum()
    assert not reserve_outliers(fewer, kept[:, half], None).any()
