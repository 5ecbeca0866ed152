import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from eitskin.data import splits
from eitskin.errors import InputError
from eitskin.learn import model_file, predict, train
from eitskin.learn.metrics import r2
from eitskin.learn.models import names
from eitskin.learn.networks.mlp import Mlp
from eitskin.learn.networks.svr import Svr
from eitskin.learn.networks.teachers import Autoencoder, StateToLatent
from eitskin.physics.protocol import channel_table
from synthetic_touches import touches

QUICK = train.Budget(samples=300, epochs=4)
ADAM = train.Optimiser()
DATA = touches(600, seed=1)
PART = splits.assign(DATA.table, "random", 1)


def recipe(budget, lambda_latent=0.0, optimiser=ADAM, **settings):
    return train.Recipe(optimiser, budget, 5.0, lambda_latent, **settings)


def seeds_of(output, seeds, train_one):
    """A model of several seeds, trained into files beside `output`."""
    paths = [output.with_name(f"{output.stem}-{seed}.pt") for seed in seeds]
    for seed, path in zip(seeds, paths, strict=True):
        train_one(path, seed)
    return model_file.read_seeds(paths)


def plain(output, budget=QUICK, data=DATA, part=PART, seeds=(1,)):
    def train_one(path, seed):
        train.train_predictor(
            train.Split(data, part), "mlp", path, recipe(budget), train.Seeds(1, seed)
        )

    return seeds_of(output, seeds, train_one)


@pytest.fixture(scope="module")
def teachers(tmp_path_factory):
    """Files of an autoencoder and a regressor trained for a little longer."""
    folder = tmp_path_factory.mktemp("teachers")
    budget = replace(QUICK, epochs=60)
    paths = folder / "autoencoder.pt", folder / "regressor.pt"
    train.train_autoencoder(train.Split(DATA, PART), paths[0], ADAM, budget, train.Seeds(1, 1), 16)
    train.train_regressor(
        train.Split(DATA, PART), paths[0], paths[1], ADAM, budget, train.Seeds(1, 1)
    )
    return paths


def informed(teachers, output, lambda_latent, budget=QUICK):
    name = "physics-informed-mlp"
    informed_recipe = recipe(budget, lambda_latent)
    train.train_predictor(
        train.Split(DATA, PART), name, output, informed_recipe, train.Seeds(1, 1), teachers
    )
    return model_file.read(output)


def test_losses_are_the_equations_over_their_components():
    draw = np.random.default_rng(1)
    state, predicted, latent = (draw.normal(size=(7, k)) for k in (3, 3, 4))
    g = draw.normal(size=(3, 4))
    tensor = torch.from_numpy
    weight = tensor(np.array([1.0, 1.0, 5.0]))
    squares = (predicted - state) ** 2
    expected = np.mean(squares[:, 0] + squares[:, 1] + 5 * squares[:, 2]) / 3
    assert train.supervision(tensor(predicted), tensor(state), weight).item() == pytest.approx(
        expected
    )
    expected = np.mean(np.linalg.norm(predicted @ g - latent, axis=1) ** 2) / 4
    module = lambda s: s @ tensor(g)  # noqa: E731
    assert train.alignment(module, tensor(predicted), tensor(latent)).item() == pytest.approx(
        expected
    )
    expected = np.mean(np.linalg.norm(2 * latent - latent, axis=1) ** 2) / 4
    assert train.reconstruction(lambda v: 2 * v, tensor(latent)).item() == pytest.approx(expected)


def test_scalers_come_from_the_training_samples_alone():
    data = touches(600, seed=1)
    outside = PART != "train"
    material = train.prepare(train.Split(data, PART), replace(QUICK, samples=None), 1)
    data.delta_V[outside] += 1.0
    data.table.loc[outside, "x_mm"] += 1e3
    shifted = train.prepare(train.Split(data, PART), replace(QUICK, samples=None), 1)
    for key, value in material.scalers.items():
        assert torch.equal(value, shifted.scalers[key])
    voltage, state = material.train
    assert len(voltage) == (PART == "train").sum()
    np.testing.assert_allclose(voltage.mean(0), 0, atol=1e-5)
    np.testing.assert_allclose(state.std(0, correction=0), 1, atol=1e-5)


def test_budget_bounds_the_samples():
    material = train.prepare(train.Split(DATA, PART), replace(QUICK, samples=100), 1)
    assert len(material.train[0]) == 100 and len(material.validation[0]) == 25


def test_a_channel_that_never_moved_is_scaled_by_the_median_channel():
    data = touches(600, seed=1)
    data.delta_V[:, 5] = 0.125
    scale = train.prepare(train.Split(data, PART), QUICK, 1).scalers["voltage_scale"]
    assert scale[5] == pytest.approx(np.delete(scale.numpy(), 5).mean(), rel=0.5)


def test_a_target_without_spread_is_refused():
    data = touches(600, seed=1)
    data.table["force_N"] = 2.0
    with pytest.raises(InputError, match="training state: found no spread"):
        train.prepare(train.Split(data, PART), QUICK, 1)


def test_same_input_same_bytes(tmp_path):
    plain(tmp_path / "a.pt")
    plain(tmp_path / "elsewhere" / "b.pt")
    paths = [tmp_path / "a-1.pt", tmp_path / "elsewhere" / "b-1.pt"]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert not list(tmp_path.glob(".*"))


def test_seeds_share_their_samples_and_nothing_else(tmp_path):
    two = plain(tmp_path / "two.pt", seeds=(1, 2))
    seed_1 = model_file.read(tmp_path / "two-1.pt")
    assert two.seeds() == [1, 2] and seed_1.seeds() == [1]
    assert torch.equal(two.tensors["1/net.0.weight"], seed_1.tensors["1/net.0.weight"])
    assert not torch.equal(two.tensors["1/net.0.weight"], two.tensors["2/net.0.weight"])
    train.train_predictor(
        train.Split(DATA, PART), "mlp", tmp_path / "other.pt", recipe(QUICK), train.Seeds(2, 2)
    )
    with pytest.raises(InputError, match=r"other\.pt: file: found another training"):
        model_file.read_seeds([tmp_path / "two-1.pt", tmp_path / "other.pt"])


def test_all_epochs_are_run_and_the_best_weights_kept(tmp_path):
    budget = replace(QUICK, epochs=120, samples=60)
    trained = plain(tmp_path / "a.pt", budget)
    scores = [validation for _, validation in trained.header["runs"][0]["history"]]
    assert len(scores) == 120 and min(scores) < scores[-1]
    voltage, state = train.prepare(train.Split(DATA, PART), budget, 1).validation
    module = trained.load_into(Mlp(208, 3), 1)
    loss = train.supervision(module(voltage), state, torch.tensor([1.0, 1.0, 5.0]))
    assert loss.item() == pytest.approx(min(scores), rel=1e-5)


def test_where_nothing_is_validated_all_is_trained_on(tmp_path):
    budget = replace(QUICK, samples=60, validated=False)
    material = train.prepare(train.Split(DATA, PART), budget, 1)
    assert (len(material.train[0]), len(material.validation[0])) == (75, 15)
    assert len(material.unvalidated_voltage) == 60
    part = plain(tmp_path / "part.pt", replace(budget, validated=True))
    assert part.header["trained_samples"] == 60
    trained = plain(tmp_path / "a.pt", budget)  # a frame of its own is no stranger to any model
    assert trained.header["trained_samples"] == 75
    assert trained.header["familiar"]["limit_distance"] > 0.0


@pytest.mark.parametrize("validated", [True, False])
def test_of_a_loss_that_rises_the_first_weights_are_kept_or_where_nothing_is_validated_the_last(
    validated,
):
    v = torch.randn(64, 3, generator=torch.Generator().manual_seed(1))
    learned, opposite = (v, v[:, :1]), (v, -v[:, :1])
    torch.manual_seed(1)
    module = torch.nn.Linear(3, 1)

    def loss(module, voltage, state):
        return (module(voltage) - state).square().mean()

    job = (loss, train.Optimiser(1e-2), train.Budget(None, 30, validated), 1)
    scores = [score for _, score in train.fit(module, (learned, opposite), *job)]
    assert scores[0] < scores[-1]
    expected = scores[0] if validated else scores[-1]
    assert loss(module, *opposite).item() == pytest.approx(expected, rel=1e-5)


def test_a_cosine_begins_with_the_rate_and_ends_near_0():
    rates = np.array([*train.learning_rates(train.Optimiser(2e-3), 1000)])
    assert rates[0] == 2e-3 and rates[-1] < 1e-5 * rates[0]
    assert rates[500] == pytest.approx(1e-3) and (np.diff(rates) < 0.0).all()
    assert {*train.learning_rates(train.Optimiser(2e-3, schedule="constant"), 9)} == {2e-3}


def test_hidden_widths_are_kept_in_the_file(tmp_path):
    path = tmp_path / "a.pt"
    train.train_predictor(
        train.Split(DATA, PART), "mlp", path, recipe(QUICK, widths=[8, 5]), train.Seeds(1, 1)
    )
    trained = model_file.read(path)
    assert trained.header["widths"] == [8, 5]
    assert trained.tensors["1/net.2.weight"].shape == (5, 8)
    assert predict.predict_seeds(trained, DATA.delta_V[:3]).shape == (1, 3, 3)


def test_subnormal_numbers_count_as_0_while_it_trains_and_never_after(tmp_path):
    def product(module, voltage, state):
        sums.append((torch.tensor([1e-38]) * torch.tensor([1e-2])).item())
        return module(voltage).square().mean()

    sums = []
    values = (torch.randn(8, 3), torch.zeros(8, 1))
    job = (product, ADAM, train.Budget(None, 1), 1)
    train.fit(torch.nn.Linear(3, 1), (values, values), *job)
    assert len(sums) == 2 and set(sums) == {0.0}
    product(torch.nn.Linear(3, 1), *values)
    assert sums[-1] > 0.0


def test_a_loss_that_is_not_finite_is_refused_and_nothing_written(tmp_path):
    wild = replace(ADAM, learning_rate=1e30)
    with pytest.raises(InputError, match="a loss that is not finite"):
        wild_recipe = recipe(QUICK, optimiser=wild)
        train.train_predictor(
            train.Split(DATA, PART), "mlp", tmp_path / "a.pt", wild_recipe, train.Seeds(1, 1)
        )
    assert not (tmp_path / "a.pt").exists()


def test_lambda_zero_is_the_plain_predictor(tmp_path, teachers):
    trained = informed(teachers, tmp_path / "informed.pt", 0.0)
    two = plain(tmp_path / "plain.pt")
    assert trained.tensors.keys() == two.tensors.keys()
    assert all(torch.equal(trained.tensors[key], two.tensors[key]) for key in trained.tensors)


def test_autoencoder_and_regressor_learn(teachers):
    voltage, state = train.prepare(train.Split(DATA, PART), QUICK, 1).validation
    autoencoder = model_file.read(teachers[0]).load_into(Autoencoder(208, 16), 1)
    latent = autoencoder.encoder(voltage)
    # half of the squared voltage is explained, and half of the latent's spread
    assert train.reconstruction(autoencoder, voltage) < 0.5 * voltage.square().mean()
    regressor = model_file.read(teachers[1]).load_into(StateToLatent(3, 16), 1)
    spread = (latent - latent.mean(0)).square().mean()
    assert train.alignment(regressor, state, latent) < 0.5 * spread


def test_the_latent_loss_pulls_predictions_to_the_manifold(tmp_path, teachers):
    material = train.prepare(train.Split(DATA, PART), QUICK, 1)
    voltage, _ = material.validation
    encoder = model_file.read(teachers[0]).load_into(Autoencoder(208, 16), 1).encoder
    regressor = model_file.read(teachers[1]).load_into(StateToLatent(3, 16), 1)
    misfit = []
    for k, lambda_latent in enumerate((0.0, 1.0)):
        trained = informed(teachers, tmp_path / f"{k}.pt", lambda_latent)
        state = trained.load_into(Mlp(208, 3), 1)(voltage)
        misfit.append(train.alignment(regressor, state, encoder(voltage)).item())
    assert misfit[1] < 0.9 * misfit[0]


def test_teachers_must_be_there_and_have_seen_the_same_samples(tmp_path, teachers):
    with pytest.raises(InputError, match="an autoencoder and a regressor"):
        informed((), tmp_path / "a.pt", 0.03)
    place_split = splits.assign(DATA.table, "place", 2)
    with pytest.raises(InputError, match="a teacher trained on the same samples"):
        train.train_regressor(
            train.Split(DATA, place_split),
            teachers[0],
            tmp_path / "a.pt",
            ADAM,
            QUICK,
            train.Seeds(1, 1),
        )
    with pytest.raises(InputError, match=r"seeds: found \[1\], expected 2, the pupil's"):
        job = (tmp_path / "a.pt", recipe(QUICK, 0.03), train.Seeds(1, 2), teachers)
        train.train_predictor(train.Split(DATA, PART), "physics-informed-mlp", *job)
    assert list(tmp_path.iterdir()) == []


TABLED = touches(600, seed=1)
TABLED.metadata["channels"] = channel_table(16).tolist()
ROW = train.Budget(samples=48, epochs=2)


@pytest.fixture(scope="module")
def row_teachers(tmp_path_factory):
    """Files of an autoencoder and a regressor for the rows' own samples."""
    folder = tmp_path_factory.mktemp("row_teachers")
    paths = folder / "autoencoder.pt", folder / "regressor.pt"
    train.train_autoencoder(train.Split(TABLED, PART), paths[0], ADAM, ROW, train.Seeds(1, 1), 16)
    train.train_regressor(
        train.Split(TABLED, PART), paths[0], paths[1], ADAM, ROW, train.Seeds(1, 1)
    )
    return paths


@pytest.mark.parametrize("name", names())
def test_every_row_is_trained_kept_and_applied_alike(tmp_path, row_teachers, monkeypatch, name):
    informed = name.startswith("physics-informed-")
    needed = 2 if informed else int(name == "autoencoder-mlp")
    row_recipe = recipe(ROW, 0.03 * informed)
    files = [tmp_path / "a.pt", tmp_path / "b.pt"]
    for file in files:
        train.train_predictor(
            train.Split(TABLED, PART),
            name,
            file,
            row_recipe,
            train.Seeds(1, 1),
            row_teachers[:needed],
        )
    assert files[0].read_bytes() == files[1].read_bytes()
    trained = model_file.read(files[0])
    assert trained.seeds() == [1]
    assert [run["device"] for run in trained.header["runs"]] == [train.device_name()]
    monkeypatch.setitem(sys.modules, "sklearn", None)  # predicting needs none of it
    monkeypatch.setitem(sys.modules, "sklearn.svm", None)
    states = predict.predict_seeds(trained, TABLED.delta_V[:300])
    assert states.shape == (1, 300, 3) and np.isfinite(states).all()
    rows = predict.predict_part(trained, TABLED, PART)
    assert set(rows["seed"]) == set(trained.seeds())


def test_the_autoencoder_mlp_keeps_its_teachers_encoder(tmp_path, row_teachers):
    name, files = "autoencoder-mlp", row_teachers[:1]
    job = (recipe(ROW), train.Seeds(1, 1))
    train.train_predictor(train.Split(TABLED, PART), name, tmp_path / "a.pt", *job, files)
    trained, teacher = model_file.read(tmp_path / "a.pt"), model_file.read(files[0])
    encoders = [key for key in trained.tensors if "/encoder." in key]
    assert len(encoders) == 6
    assert all(torch.equal(trained.tensors[key], teacher.tensors[key]) for key in encoders)
    with pytest.raises(InputError, match="waves: autoencoder: found none"):
        train.train_predictor(train.Split(TABLED, PART), name, tmp_path / "b.pt", *job)
    with pytest.raises(InputError, match="a teacher trained on the same samples"):
        larger_recipe = recipe(replace(ROW, samples=50))
        train.train_predictor(
            train.Split(TABLED, PART),
            name,
            tmp_path / "b.pt",
            larger_recipe,
            train.Seeds(1, 1),
            files,
        )


def test_support_vectors_have_scikit_learns_settings_and_the_loss_of_their_fit(tmp_path):
    budget = replace(QUICK, samples=200)
    train.train_predictor(
        train.Split(TABLED, PART), "svr", tmp_path / "a.pt", recipe(budget), train.Seeds(1, 1)
    )
    trained = model_file.read(tmp_path / "a.pt")
    assert trained.header["optimiser"] == {"C": 1.0, "epsilon": 0.1}
    assert "lambda_latent" not in trained.header and "force_weight" not in trained.header
    voltage, state = train.prepare(train.Split(TABLED, PART), budget, 1).validation
    module = trained.load_into(Svr(208, 3), 1)
    loss = train.supervision(module(voltage), state, torch.tensor([1.0, 1.0, 5.0]))
    assert trained.header["runs"][0]["history"][0][1] == pytest.approx(loss.item(), rel=1e-6)
    truth = state.var(dim=0, correction=0).sum() / 3
    assert (module(voltage) - state).square().mean() < 0.3 * truth


def test_drives_as_tokens_need_the_table_of_channels(tmp_path):
    with pytest.raises(InputError, match="waves: channels: found no table"):
        train.train_predictor(
            train.Split(DATA, PART),
            "transformer",
            tmp_path / "a.pt",
            recipe(ROW),
            train.Seeds(1, 1),
        )
    assert not (tmp_path / "a.pt").exists()


def test_it_learns_the_contact_state(tmp_path):
    data = touches(3000, seed=2)
    part = splits.assign(data.table, "random", 1)
    budget = train.Budget(samples=None, epochs=25)
    trained = plain(tmp_path / "a.pt", budget, data, part)
    predictions = predict.predict_part(trained, data, part)
    truth = data.table[part == "test"]
    for column in ("x_mm", "y_mm", "force_N"):
        assert r2(truth[column].to_numpy(), predictions[column].to_numpy()) > 0.95
