import pytest
import torch

from eitskin import models
from eitskin.errors import InputError


def widths(module):
    return [
        (layer.in_features, layer.out_features)
        for layer in module.modules()
        if isinstance(layer, torch.nn.Linear)
    ]


def test_networks_have_the_papers_widths():
    assert widths(models.Mlp(208, 3)) == [(208, 256), (256, 128), (128, 64), (64, 3)]
    autoencoder = models.Autoencoder(208, 16)
    assert widths(autoencoder.encoder) == [(208, 256), (256, 64), (64, 16)]
    assert widths(autoencoder.decoder) == [(16, 64), (64, 256), (256, 208)]
    assert widths(models.StateToLatent(3, 16)) == [(3, 128), (128, 128), (128, 16)]


def test_outputs_are_linear():
    for module in (models.Mlp(8, 3), models.Autoencoder(8, 4), models.StateToLatent(8, 4)):
        assert isinstance(list(module.modules())[-1], torch.nn.Linear)


def test_physics_informed_is_a_way_to_train_any_predictor():
    assert type(models.predictor("physics-informed-mlp", 208, 3)) is models.Mlp
    with pytest.raises(InputError, match="'gru', expected one of mlp, physics-informed-mlp"):
        models.predictor("gru", 208, 3)


def trained():
    torch.manual_seed(5)
    weights = models.Mlp(8, 3).state_dict()
    tensors = {f"{seed}/{key}": value + seed for seed in (1, 11) for key, value in weights.items()}
    return models.Trained({"runs": [{"seed": 1}, {"seed": 11}]}, tensors)


def test_file_is_byte_repeatable_whatever_its_path(tmp_path):
    models.write(trained(), tmp_path / "a.pt")
    models.write(models.read(tmp_path / "a.pt"), tmp_path / "another-name.pt")
    assert (tmp_path / "a.pt").read_bytes() == (tmp_path / "another-name.pt").read_bytes()


def test_each_seed_gets_its_own_weights(tmp_path):
    models.write(trained(), tmp_path / "a.pt")
    read = models.read(tmp_path / "a.pt")
    first, second = (read.into(models.Mlp(8, 3), seed) for seed in read.seeds())
    difference = second.net[0].weight - first.net[0].weight
    torch.testing.assert_close(difference, torch.full_like(difference, 10.0))
    assert not any(p.requires_grad for p in first.parameters())


def test_other_files_are_refused(tmp_path):
    models.write(trained(), tmp_path / "a.pt")
    (tmp_path / "cut.pt").write_bytes((tmp_path / "a.pt").read_bytes()[:500])
    (tmp_path / "text.pt").write_text("not a model")
    (tmp_path / "empty.pt").write_bytes(b"")
    torch.save({"w": torch.zeros(3)}, tmp_path / "other.pt")
    for name in ("cut", "text", "empty", "other", "absent"):
        with pytest.raises(InputError, match=rf"{name}\.pt: file: found"):
            models.read(tmp_path / f"{name}.pt")
