import pytest
import torch

from eitskin.errors import InputError
from eitskin.learn import model_file
from eitskin.learn.networks.mlp import Mlp


def trained():
    torch.manual_seed(5)
    weights = Mlp(8, 3).state_dict()
    tensors = {f"{seed}/{key}": value + seed for seed in (1, 11) for key, value in weights.items()}
    return model_file.Trained({"runs": [{"seed": 1}, {"seed": 11}]}, tensors)


def test_file_is_byte_repeatable_whatever_its_path(tmp_path):
    model_file.write(trained(), tmp_path / "a.pt")
    model_file.write(model_file.read(tmp_path / "a.pt"), tmp_path / "another-name.pt")
    assert (tmp_path / "a.pt").read_bytes() == (tmp_path / "another-name.pt").read_bytes()


def test_each_seed_gets_its_own_weights(tmp_path):
    model_file.write(trained(), tmp_path / "a.pt")
    read = model_file.read(tmp_path / "a.pt")
    seed_1, seed_2 = (read.load_into(Mlp(8, 3), seed) for seed in read.seeds())
    difference = seed_2.net[0].weight - seed_1.net[0].weight
    torch.testing.assert_close(difference, torch.full_like(difference, 10.0))
    assert not any(p.requires_grad for p in seed_1.parameters())


def test_other_files_are_refused(tmp_path):
    model_file.write(trained(), tmp_path / "a.pt")
    (tmp_path / "cut.pt").write_bytes((tmp_path / "a.pt").read_bytes()[:500])
    (tmp_path / "text.pt").write_text("not a model")
    (tmp_path / "empty.pt").write_bytes(b"")
    torch.save({"w": torch.zeros(3)}, tmp_path / "other.pt")
    for name in ("cut", "text", "empty", "other", "absent"):
        with pytest.raises(InputError, match=rf"{name}\.pt: file: found"):
            model_file.read(tmp_path / f"{name}.pt")
