"""The bench compares like with like, and writes what its readers expect."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from benchmark import diagnoses, rows, speed

pytest.importorskip("pyeit")


@pytest.fixture(scope="module")
def mesh():
    return speed.MeshSamples()


def test_every_solver_on_the_mesh_gives_the_same_voltages(mesh):
    solvers = [mesh.by_factoring, speed.Woodbury(mesh, False), speed.Woodbury(mesh, True)]
    assert speed.disagreement(mesh, solvers) < speed.AGREEMENT


def test_a_solver_that_computes_something_else_is_noticed(mesh):
    assert speed.disagreement(mesh, [lambda s: mesh.by_factoring(s[::-1])]) > 1e-3


def test_the_forward_model_simulates_the_samples_of_the_mesh(mesh):
    """Equal up to the mesh's own error: touches ragged by whole elements, rim of chords."""
    ours, peer = speed.by_forward_model([]), mesh.by_touch_modes([])
    assert ours.shape == peer.shape == (192 * 260, 208)
    assert np.median(abs(ours - peer) / abs(peer)) < 0.02


def test_samples_are_spread_over_places_and_strengths():
    samples = speed.spread_samples(96)
    assert samples[0] == (0, 0)
    assert samples[-1] == (191, 259)
    assert len({place for place, _ in samples}) == 96


def quick(runs):
    return [
        rows.row("clean", "samples/s", [6.0, 5.0, 9.0][:runs], "a peer", [2.0, 1.0, 3.0][:runs])
    ]


def test_rows_are_written_as_a_list_with_command_commit_and_machine(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(speed, "BENCHES", {"clean": quick})
    speed.main(["clean", "--runs", "3", "--output", str(tmp_path)])
    (row,) = json.loads((tmp_path / "clean.json").read_text())
    assert (row["ours"], row["peer"], row["ratio"], row["runs"]) == (6.0, 2.0, 3.0, 3)
    assert (row["ours_runs"], row["peer_runs"]) == ([6.0, 5.0, 9.0], [2.0, 1.0, 3.0])
    assert "python -m benchmark.speed clean --runs 3" in row["command"]
    assert set(row["machine"]) == {"processor", "cores", "memory_GiB"}
    assert row["commit"] and row["others_cores"] >= 0.0
    assert "ratio 3" in capsys.readouterr().out


def test_several_benches_are_run_and_no_others(tmp_path, monkeypatch):
    monkeypatch.setattr(speed, "BENCHES", {"one": quick, "two": quick, "three": None})
    speed.main(["one", "two", "--runs", "1", "--output", str(tmp_path)])
    assert sorted(file.name for file in tmp_path.iterdir()) == ["one.json", "two.json"]


def test_a_bench_that_there_is_not_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        speed.main(["cleaned", "--output", str(tmp_path)])
    assert "no bench: cleaned" in capsys.readouterr().err


def test_the_loop_is_timed_as_it_is_and_with_subnormal_numbers(monkeypatch):
    monkeypatch.setattr(speed, "TRAINED", 500)
    monkeypatch.setattr(speed, "EPOCHS", 2)
    (row,) = speed.trained(2)
    assert row["peer_name"] == "subnormal numbers kept" and row["runs"] == 2
    assert min(row["ours_runs"]) > 0.0 and min(row["peer_runs"]) > 0.0


@pytest.fixture
def small():
    """The shipped configuration with few places and forces."""
    config = yaml.safe_load((Path(__file__).parents[3] / "config.yaml").read_text())
    config["touch_grid"] |= {"radii": 2, "angles": 3}
    config["forces"]["levels"] = 4
    return config


def test_new_skins_are_pressed_on_one_core_and_on_two(small, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert min(speed.skins_a_second(small, threads) for threads in (1, 2)) > 0.0


def test_a_perturbed_set_runs_the_whole_chain(small):
    samples, seconds, peak = speed.perturb(small, "authors")
    assert samples == 24
    assert seconds > 0
    assert peak > 10


@pytest.mark.long
def test_a_drawn_recording_is_diagnosed():
    seconds, peak = diagnoses.diagnose("null", 1, 60, 1)
    assert seconds > 0
    assert peak > 10
