"""One file and one line are a model: trained plainly and by equation 8, kept and applied."""

import importlib

import numpy as np
import pytest

from eitskin import learn
from eitskin.configuration import schema
from eitskin.data import splits
from eitskin.learn import model_file, models, predict, train
from eitskin.pins import ROOT
from synthetic_touches import touches

TOYS = '''
"""A line through the readings, and one through an autoencoder's latent ones."""

from torch import nn

from eitskin.learn.networks.teachers import Autoencoder


class Straight(nn.Module):
    """States (B, T) of voltages (B, M)."""

    def __init__(self, encoder, width, n_targets):
        super().__init__()
        self.encoder = encoder.requires_grad_(False)
        self.line = nn.Linear(width, n_targets)

    def forward(self, voltage):
        return self.line(self.encoder(voltage))


def straight(shape):
    return Straight(nn.Identity(), shape.n_channels, shape.n_targets)


def latent(shape):
    encoder = Autoencoder(shape.n_channels, shape.latent_dim).encoder
    return Straight(encoder, shape.latent_dim, shape.n_targets)
'''
DATA = touches(400, seed=1)
PART = splits.assign(DATA.table, "random", 1)
BUDGET = train.Budget(samples=100, epochs=2)
RECIPE = train.Recipe(train.Optimiser(), BUDGET, 5.0, latent_dim=8)


@pytest.fixture(autouse=True)
def toys(tmp_path, monkeypatch):
    """The registry with both."""
    (tmp_path / "toy_lines.py").write_text(TOYS, encoding="utf-8")
    monkeypatch.setattr(learn, "__path__", [*learn.__path__, str(tmp_path)])
    importlib.invalidate_caches()
    monkeypatch.setitem(models.MODELS, "toy-line", models.Model("toy_lines.straight"))
    latent = models.Model("toy_lines.latent", encoder=True)
    monkeypatch.setitem(models.MODELS, "toy-latent-line", latent)


@pytest.mark.parametrize("name", ["toy-line", "toy-latent-line"])
@pytest.mark.parametrize("informed", [False, True])
def test_it_is_trained_kept_and_applied(name, informed):
    if informed:
        recipe = train.Recipe(RECIPE.optimiser, BUDGET, 5.0, 0.03, latent_dim=8)
        name = models.PHYSICS_INFORMED + name
    trained = train.train_model(train.Split(DATA, PART), name, recipe if informed else RECIPE, 1)
    assert trained.header["model"] == name and trained.seeds() == [1]
    states = predict.predict_seeds(trained, DATA.delta_V[:20])
    assert states.shape == (1, 20, 3) and np.isfinite(states).all()


def test_its_encoder_is_its_teacher_s(tmp_path):
    job = (train.Optimiser(), BUDGET, train.Seeds(1, 1))
    teacher, output = tmp_path / "autoencoder.pt", tmp_path / "a.pt"
    train.train_autoencoder(train.Split(DATA, PART), teacher, *job, 8)
    train.train_predictor(
        train.Split(DATA, PART), "toy-latent-line", output, RECIPE, train.Seeds(1, 1), [teacher]
    )
    trained, taught = model_file.read(output).tensors, model_file.read(teacher).tensors
    encoders = [key for key in trained if "/encoder." in key]
    assert encoders and all((trained[key] == taught[key]).all() for key in encoders)


def test_the_configuration_and_the_rules_know_it():
    model_schema = schema(ROOT / "workflow" / "schemas" / "config.schema.yaml")["$defs"]["models"]
    assert {"toy-line", "physics-informed-toy-line"} < {*model_schema["items"]["enum"]}
    assert {name for name in models.names() if models.model(name).encoder} == {
        start + name
        for start in ("", models.PHYSICS_INFORMED)
        for name in ("autoencoder-mlp", "toy-latent-line")
    }
    assert models.model("physics-informed-toy-line").module == "eitskin.learn.toy_lines"
