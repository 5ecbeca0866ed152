import numpy as np
import pytest

from eitskin.data import dataset, importers, splits
from eitskin.learn import metrics, model_file, predict, train
from shared_data import shared_data

RECIPE = train.Recipe(train.Optimiser(), train.Budget(samples=None, epochs=60), 5.0)


@pytest.mark.parametrize(
    ("path", "targets", "unit"),
    [
        ("hydrogel-skin/ohmc16.mat", ["x", "y", "depth"], "arbitrary"),
        ("hydrogel-skin/ohmc8.mat", ["x", "y", "depth"], "arbitrary"),
        ("patterned-skin/inp_noPattern.csv", ["x", "y"], None),
    ],
)
@pytest.mark.parametrize("kind", ["random", "place"])
def test_a_real_skin_is_learned_from(tmp_path, path, targets, unit, kind):
    recording = importers.load(shared_data(path), None)
    data = dataset.from_recording(recording, "a real skin")
    assert data.metadata["targets"] == targets
    assert unit is None or data.metadata["unit"] == unit
    assert len(data.table) == recording.frames["touch"].sum()
    part = splits.assign(data.table, kind, 1)
    assert 0.15 < (part == "test").mean() < 0.25
    model_path = tmp_path / "mlp.pt"
    split = train.Split(data, part)
    train.train_predictor(split, "mlp", model_path, RECIPE, train.Seeds(1, 1))
    model = model_file.read(model_path)
    prediction = predict.predict_part(model, data, part)
    table = metrics.evaluate(prediction, data, kind, "small", model.header)
    assert (table["mean"][table["metric"] == "r2"] > 0.85).all()
    assert prediction["abstain"].mean() < 0.1
    test = data.delta_V[part == "test"]
    order = np.random.default_rng(0).permutation(test.shape[1])
    assert predict.judge(model, test[:, order])["abstain"].mean() > 0.7
