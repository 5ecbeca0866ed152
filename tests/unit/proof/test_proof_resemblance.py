"""How far an effect moves the measures of similarity: not at all, and plainly."""

import numpy as np
import pytest

from eitskin.errors import InputError
from eitskin.paper.similarity import MEASURES
from proof.resemblance import moves

NOISE = 0.01


def skin(frames: int = 40, channels: int = 30) -> np.ndarray:
    """(N, M): readings of a touch that comes and goes."""
    rng = np.random.default_rng(1)
    level, touch = rng.uniform(0.5, 2.0, channels), rng.standard_normal(channels)
    return level + 0.05 * np.abs(np.sin(np.arange(frames)))[:, None] * touch


def moved(signature: np.ndarray, seed: int, factor: float = 1.0) -> dict:
    plain = skin()
    mended = plain + signature
    noise = NOISE * np.random.default_rng([7, seed]).standard_normal(plain.shape)
    sd = np.full(plain.shape[1], NOISE)
    return moves(factor * mended + noise, plain, mended, sd, seed, 60)


def test_nothing_moves_nothing():
    found = [moved(np.zeros((40, 30)), seed) for seed in range(10)]
    outside = np.array([[one[m]["moved"] for m in MEASURES] for one in found])
    assert outside.mean(axis=0).max() <= 0.3  # one in twenty is chance
    assert set(found[0]) == set(MEASURES)


def test_the_conductivity_is_the_owners_to_calibrate():
    found = [moved(np.zeros((40, 30)), seed, 1.15) for seed in range(10)]
    assert np.mean([one["swd"]["moved"] for one in found]) <= 0.3


def test_a_strong_effect_moves_them_nearer():
    gain = skin() * np.where(np.arange(30) == 4, 0.3, 0.0)
    one = moved(gain, 3)
    for measure in ("mmd", "swd"):
        assert one[measure]["moved"] and one[measure]["change"] > one[measure]["high"]
        assert one[measure]["change"] == pytest.approx(
            one[measure]["plain"] - one[measure]["mended"]
        )
    assert one["ncc"]["moved"] and one["ncc"]["change"] < 0.0


def test_the_same_bit_for_bit():
    gain = 0.02 * skin()
    assert moved(gain, 5) == moved(gain, 5) != moved(gain, 6)


def test_lost_channels_are_left_out():
    plain = skin()
    recorded = plain + NOISE * np.random.default_rng(2).standard_normal(plain.shape)
    sd = np.full(30, NOISE)
    lost = recorded.copy()
    lost[3, 7] = np.nan
    assert np.isfinite(moves(lost, plain, plain, sd, 1, 20)["coral"]["change"])
    with pytest.raises(InputError, match="vary"):
        moves(plain[:1], plain[:1], plain[:1], sd, 1)
