"""What results cost, from the files that Snakemake leaves."""

import pytest

from benchmark import hours
from eitskin.errors import InputError

HEAD = "s\th:m:s\tmax_rss\tmax_vms\tmax_uss\tmax_pss\tio_in\tio_out\tmean_load\tcpu_time\n"


def left(folder, name, seconds):
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"{HEAD}9.9\t0:00:09\t1\t1\t1\t1\t0\t0\t50.0\t{seconds}\n")


@pytest.fixture
def folder(tmp_path):
    for seed in (1, 2):
        left(tmp_path, f"train_predictor/simulated-a/random/full/mlp/{seed}.tsv", 60.0)
        left(
            tmp_path, f"train_predictor/simulated-a/random/full/physics-informed-mlp/{seed}.tsv", 90
        )
        left(tmp_path, f"train_autoencoder/simulated-a/random/full/{seed}.tsv", 30.0)
        left(tmp_path, f"train_regressor/simulated-a/random/full/{seed}.tsv", 15.0)
    left(tmp_path, "evaluate/simulated-a/random/full/mlp.tsv", 6.0)
    left(tmp_path, "perturb/a/1-channel-gain.tsv", "NA")
    left(tmp_path, "mesh.tsv", 3.0)
    return tmp_path


def test_a_row_a_model_one_of_teachers_one_of_every_other_rule(folder):
    cost_rows = hours.costs(folder).set_index("what")
    assert list(cost_rows.index) == ["mlp", "physics-informed-mlp", "teachers", "mesh", "perturb"]
    assert cost_rows["jobs"].tolist() == [2, 2, 4, 1, 1]
    assert cost_rows["minutes"].tolist() == pytest.approx([2.1, 3.0, 1.5, 0.05, 0.0])
    assert cost_rows.loc["mlp", ["set", "split", "budget"]].tolist() == [
        "simulated-a",
        "random",
        "full",
    ]


def test_the_sum_is_said_in_hours(folder, capsys):
    assert hours.run([str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "| simulated-a | random | full | mlp | 2 | 2.1 |" in printed
    assert printed.endswith("Together 0.11 processor hours.\n")


def test_a_folder_without_files_and_a_file_of_another_form_are_refused(tmp_path, capsys):
    assert hours.run([str(tmp_path)]) == 2
    assert "benchmark files: found none" in capsys.readouterr().err
    (tmp_path / "other.tsv").write_text("a\tb\n1\t2\n")
    with pytest.raises(InputError, match=r"other\.tsv: columns: found \['a', 'b'\]"):
        hours.costs(tmp_path)
    (tmp_path / "other.tsv").write_text("")
    with pytest.raises(InputError, match=r"other\.tsv: file: found No columns"):
        hours.costs(tmp_path)
    assert hours.run(["a", "b"]) == 2
