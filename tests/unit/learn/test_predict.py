import numpy as np
import pandas as pd
import pytest

from eitskin.data import dataset, splits
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.learn import model_file, predict, train
from eitskin.physics.protocol import channel_table
from synthetic_touches import changes, touches

NOISE = 2e-5
BUDGET = train.Budget(samples=None, epochs=16)
RECIPE = train.Recipe(train.Optimiser(), BUDGET, 5.0)


def fitted(folder, data, kind="random"):
    part = splits.assign(data.table, kind, 1)
    paths = [folder / "1.pt", folder / "2.pt"]
    for seed, path in enumerate(paths, start=1):
        train.train_predictor(train.Split(data, part), "mlp", path, RECIPE, train.Seeds(1, seed))
    return model_file.read_seeds(paths), part


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    data = touches(4000, seed=1, noise=NOISE)
    return fitted(tmp_path_factory.mktemp("model"), data)[0]


def test_new_frames_like_those_trained_on_are_seldom_abstained_from(trained):
    gate_table = predict.judge(trained, touches(4000, seed=7, noise=NOISE).delta_V)
    assert gate_table["abstain"].mean() < 0.02
    assert gate_table["touch"].all()


def test_untouched_frames_are_seldom_called_touched(trained):
    untouched = NOISE * np.random.default_rng(8).normal(size=(4000, 208))
    assert predict.judge(trained, untouched)["touch"].mean() < 0.03
    assert trained.header["touch"]["calibrated_on"] == "untouched frames"


@pytest.mark.parametrize(
    "spoil",
    [
        lambda v, draw: v[:, draw.permutation(208)],
        lambda v, draw: draw.permuted(v, axis=1),
        lambda v, draw: draw.normal(scale=v.std(), size=v.shape),
        lambda v, draw: -v,
        lambda v, draw: 10 * v,
        lambda v, draw: np.where(np.arange(208) == 17, v + 1e-3, v),
    ],
    ids=["other order", "shuffled", "noise", "sign", "gain", "one channel off"],
)
def test_frames_off_the_training_set_are_abstained_from(trained, spoil):
    frames = touches(500, seed=9, noise=NOISE).delta_V
    gate_table = predict.judge(trained, spoil(frames, np.random.default_rng(1)))
    assert gate_table["abstain"].mean() > 0.9


@pytest.mark.parametrize(("channels", "samples"), [(4, 200), (208, 30)])
def test_few_channels_or_frames_without_noise_still_have_limits(tmp_path, channels, samples):
    data = touches(samples, seed=1, noise=0.0)
    data.delta_V = np.ascontiguousarray(data.delta_V[:, :channels])
    model, _ = fitted(tmp_path, data)
    assert 0 < model.header["familiar"]["limit_distance"] < np.inf
    assert 0 < model.header["familiar"]["limit_residual"] < np.inf
    assert predict.judge(model, data.delta_V)["abstain"].mean() < 0.2


def test_without_untouched_frames_the_weakest_touches_set_the_threshold(tmp_path):
    data = touches(3000, seed=1, noise=NOISE)
    data.metadata["untouched"] = None
    model, _ = fitted(tmp_path, data)
    gate = model.header["touch"]
    assert gate["calibrated_on"] == "weakest touches"
    assert 0.98 <= gate["detected"] <= 1.0
    new = predict.judge(model, touches(3000, seed=3, noise=NOISE).delta_V)
    assert new["touch"].mean() > 0.97
    assert not predict.judge(model, np.zeros((1, 208)))["touch"].any()


def test_predict_is_the_mean_over_the_seeds(trained):
    frames = touches(20, seed=2).delta_V
    states = predict.predict_seeds(trained, frames)
    assert states.shape == (2, 20, 3)
    predictions = predict.predict(trained, frames)
    assert list(predictions.columns) == ["x_mm", "y_mm", "force_N", "touch", "abstain"]
    np.testing.assert_allclose(predictions[["x_mm", "y_mm", "force_N"]], states.mean(axis=0))


def test_a_frame_does_not_depend_on_the_frames_beside_it(trained):
    frames = touches(20, seed=2).delta_V
    alone = predict.predict(trained, frames[3:4])
    together = predict.predict(trained, frames).iloc[3:4].reset_index(drop=True)
    pd.testing.assert_frame_equal(alone, together, rtol=1e-4)


def test_a_lost_reading_is_abstained_from(trained):
    frames = touches(3, seed=2).delta_V
    frames[1, 4] = np.nan
    predictions = predict.predict(trained, frames)
    assert predictions["abstain"][1] and np.isnan(predictions["x_mm"][1])
    assert predictions["touch"].all() and np.isfinite(predictions["x_mm"][[0, 2]]).all()


def test_other_channel_counts_are_refused(trained):
    with pytest.raises(InputError, match=r"found \(5, 32\), expected \(frames, 208\)"):
        predict.predict(trained, np.zeros((5, 32)))


def test_a_file_without_a_predictor_is_refused(tmp_path):
    data = touches(300, seed=1)
    part = splits.assign(data.table, "random", 1)
    train.train_autoencoder(
        train.Split(data, part), tmp_path / "a.pt", train.Optimiser(), BUDGET, train.Seeds(1, 1), 16
    )
    with pytest.raises(InputError, match="'autoencoder', expected one of svr, mlp"):
        predict.predict(model_file.read(tmp_path / "a.pt"), data.delta_V)


def press(seed, n=400, **metadata):
    """A recording untouched and pressed in turn, on a skin that drifts, one channel lost."""
    draw = np.random.default_rng(seed)
    touch = np.tile([False, True], n)
    x, y = draw.integers(-4, 5, (2, 2 * n)) * 14.0
    force = draw.uniform(1, 10, 2 * n)
    voltage = np.linspace(1.0, 1.02, 2 * n)[:, None] + touch[:, None] * changes(x, y, force)
    voltage += 1e-4 * draw.normal(size=voltage.shape)
    voltage[:, 9] = np.nan
    metadata_columns = {
        "values": "absolute",
        "unit": "V",
        "voltage": "signed",
        "position_frame": "skin",
    }
    frames = frames_table(np.arange(2 * n) * 0.1, touch, x, y, force, 10.0)
    channels = {"channels": channel_table(16).tolist(), "source": "a citation"}
    return Recording(frames, voltage, None, None, {**metadata_columns, **channels, **metadata})


def test_predict_recording_judges_every_frame(tmp_path):
    model, _ = fitted(tmp_path, dataset.from_recording(press(1), "one day"))
    predictions = predict.predict_recording(model, press(2), "the next")
    assert list(predictions.columns[:2]) == ["frame", "time_s"] and len(predictions) == 800
    touch = np.tile([False, True], 400)
    assert predictions["touch"][touch].mean() > 0.9
    assert predictions["touch"][~touch].mean() < 0.1
    assert predictions["abstain"][0]  # nothing was measured before the first frame
    assert predictions["abstain"][touch].mean() < 0.1
    truth = press(2).frames["x_mm"]
    assert np.corrcoef(predictions["x_mm"][touch], truth[touch])[0, 1] > 0.9


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"unit": "ohm"}, "unit: found 'ohm', expected those of one day"),
        ({"voltage": "magnitude"}, "voltage: found 'magnitude'"),
        ({"channels": channel_table(16, "opposite")[:208].tolist()}, "channels: found"),
        ({"channels": channel_table(16)[::-1].tolist()}, "channels: found"),
    ],
)
def test_predict_recording_refuses_another_instrument(tmp_path, changed, message):
    model, _ = fitted(tmp_path, dataset.from_recording(press(1, n=100), "one day"))
    with pytest.raises(InputError, match=message):
        predict.predict_recording(model, press(2, n=100, **changed), "the next")


def test_a_part_is_predicted_whole_for_every_seed(tmp_path):
    data = touches(400, seed=1)
    model, part = fitted(tmp_path, data, "place")
    predictions = predict.predict_part(model, data, part, "test")
    assert list(predictions.columns) == [
        *("sample", "seed", "x_mm", "y_mm", "force_N", "touch", "abstain")
    ]
    for seed in (1, 2):
        samples = predictions["sample"][predictions["seed"] == seed]
        assert (samples.to_numpy() == np.flatnonzero(part == "test")).all()
    predict.write(predictions, tmp_path / "a.parquet")
    predict.write(predictions, tmp_path / "b.parquet")
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "a.parquet"), predictions)
