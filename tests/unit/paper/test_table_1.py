import os
import re
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from eitskin.errors import InputError
from eitskin.learn import metrics
from eitskin.limit import score
from eitskin.paper import table_1
from eitskin.pins import ROOT

PAPER = ROOT / "workflow" / "eitskin" / "paper" / "printed_table_1.csv"
HEADER = (
    "configuration,recording,split,model,target,metric,mean,low,high,unit,seeds,budget,"
    "trained_samples,epochs,tested_samples,limit,paper"
)
REPEATED = ["authors", "text"]


def metric_file(folder, **given):
    """A metrics file with R² and MAE of x and F; the mean is 0.5, the interval 0.4 to 0.6."""
    row = {
        "configuration": "text",
        "recording": "simulated",
        "origin": "simulated",
        "split": "random",
        "model": "mlp",
        "mean": 0.5,
        "low": 0.4,
        "high": 0.6,
        "seeds": 2,
        "budget": "small",
        "trained_samples": 6000,
        "epochs": 40,
        "tested_samples": 9984,
        **given,
    }
    rows = [
        {**row, "target": target, "metric": metric, "unit": "1" if metric == "r2" else "N"}
        for target in ("x", "F")
        for metric in ("r2", "mae", "rmse")
    ]
    path = folder / f"{abs(hash(tuple(row.values())))}.csv"
    metrics.write(pd.DataFrame(rows, columns=list(metrics.COLUMNS)), path)
    return path


def limit_file(folder):
    """The limit of a set whose touches lie everywhere: 0.9, and 0.95 with skin and gains known."""
    row = {"configuration": "text", "recording": "simulated", "split": "continuous"}
    row |= {"low": 0.8, "high": 1.0, "unit": "1", "samples": 300}
    rows = [
        {**row, "estimate": estimate, "target": target, "metric": metric, "value": value}
        for estimate, value in (("limit", 0.9), ("limit_known", 0.95))
        for target in ("x", "F")
        for metric in ("r2", "mae", "rmse", "z2")
    ]
    path = folder / "limit.csv"
    metrics.write(pd.DataFrame(rows, columns=list(score.COLUMNS)), path)
    return path


def write(folder, *paths, limits=(), repeated=REPEATED):
    tables = folder / "table_1.csv", folder / "table_1.md"
    table_1.write(list(paths), PAPER, repeated, list(limits), *tables)
    return pd.read_csv(folder / "table_1.csv", keep_default_na=False)


def test_the_papers_numbers_are_all_there():
    paper = table_1.paper(PAPER)
    assert len(paper) == 2 * 7 * 3 * 2
    assert not paper.duplicated(["recording", "model", "target", "metric"]).any()
    cell = paper.set_index(["recording", "model", "target", "metric"])["value"]
    assert cell["simulated", "physics-informed-mlp", "F", "r2"] == 0.92
    assert cell["simulated", "transformer", "y", "mae"] == 2.83
    assert cell["real", "mlp", "F", "mae"] == 0.75
    assert cell["real", "svr", "x", "mae"] == 0.7
    assert cell["real", "cnn-transformer", "F", "r2"] == 0.62


def test_columns_are_exactly_these_and_the_paper_stands_beside(tmp_path):
    table = write(tmp_path, metric_file(tmp_path))
    assert (tmp_path / "table_1.csv").read_text().splitlines()[0] == HEADER
    cell = table.set_index(["target", "metric"])["paper"]
    assert (cell["F", "r2"], cell["F", "mae"], cell["x", "mae"]) == ("0.89", "0.48", "1.73")
    assert cell["F", "rmse"] == ""
    table = write(tmp_path, metric_file(tmp_path, configuration="authors"))
    assert table.set_index(["target", "metric"])["paper"]["F", "r2"] == "0.89"
    assert set(table["limit"]) == {""}


@pytest.mark.parametrize(
    "given",
    [
        {"split": "place"},
        {"configuration": "averaged"},
        {"configuration": "crossed"},
        {"configuration": "my-own"},
        {"recording": "bench-top", "configuration": "", "origin": "a citation"},
        {"recording": "real", "configuration": "", "origin": "a citation"},
        {"model": "gru"},
    ],
)
def test_no_number_of_the_papers_beside_another_experiment(tmp_path, given):
    assert set(write(tmp_path, metric_file(tmp_path, **given))["paper"]) == {""}


def test_no_number_of_the_papers_beside_a_configuration_that_was_edited(tmp_path):
    metric_files = metric_file(tmp_path), metric_file(tmp_path, configuration="authors")
    for repeated, beside in (([], set()), (["authors"], {"authors"})):
        table = write(tmp_path, *metric_files, repeated=repeated)
        assert set(table["configuration"][table["paper"] != ""]) == beside


def test_the_table_says_how_much_was_trained_and_tested(tmp_path):
    table = write(
        tmp_path,
        metric_file(tmp_path, seeds=3),
        metric_file(tmp_path, model="cnn", epochs=20),
        metric_file(tmp_path, split="place", trained_samples=12, epochs=1, tested_samples=9),
    )
    counts = table.set_index(["split", "model"])[["trained_samples", "epochs", "tested_samples"]]
    assert counts.loc["random", "cnn"].to_numpy()[0].tolist() == [6000, 20, 9984]
    assert counts.loc["place", "mlp"].to_numpy()[0].tolist() == [12, 1, 9]
    text = (tmp_path / "table_1.md").read_text()
    assert "trained on 6,000 samples · epochs 20/40 · seeds 2/3 · tested on 9,984" in text
    assert "\ntrained on 12 samples · epochs 1 · seeds 2 · tested on 9\n" in text


def test_order_of_the_files_does_not_matter(tmp_path):
    paths = [
        metric_file(tmp_path),
        metric_file(tmp_path, model="physics-informed-mlp"),
        metric_file(tmp_path, split="place"),
        metric_file(tmp_path, budget="full"),
        metric_file(tmp_path, recording="bench-top", configuration="", origin="a citation"),
    ]
    table = write(tmp_path, *paths)
    written = [tmp_path / "table_1.csv", tmp_path / "table_1.md"]
    file_bytes = [path.read_bytes() for path in written]
    write(tmp_path, *reversed(paths))
    assert [path.read_bytes() for path in written] == file_bytes
    assert len(table) == 30
    text = table[(table["configuration"] == "text") & (table["budget"] == "small")]
    assert list(text["split"].unique()) == ["random", "place"]
    assert list(text["model"][text["split"] == "random"].unique()) == [
        "mlp",
        "physics-informed-mlp",
    ]
    assert list(text["target"][:6]) == ["x"] * 3 + ["F"] * 3


def test_markdown_has_interval_and_paper_and_labels_simulations(tmp_path):
    one_seed = metric_file(tmp_path, seeds=1, low=None, high=None, each="0.5", split="session")
    twin = metric_file(tmp_path, recording="twin", configuration="")
    write(tmp_path, metric_file(tmp_path), one_seed, twin)
    text = (tmp_path / "table_1.md").read_text()
    assert "## simulated, text · split by random · budget small\n" in text
    assert "## twin (simulated) · split by random" in text
    assert "0.500 [0.400, 0.600] (0.89)" in text
    two = {"each": "0.48;0.52", "low": None, "high": None}
    write(tmp_path, metric_file(tmp_path, **two))
    assert "0.500 [0.480; 0.520] (0.89)" in (tmp_path / "table_1.md").read_text()
    session = text.split("split by session")[1]
    assert "| mlp | 0.500 | 0.500 |" in session


def test_an_ensemble_of_seeds_is_a_row_of_its_own_without_a_number_of_the_papers(tmp_path):
    table = write(tmp_path, metric_file(tmp_path, ensemble=0.45))
    assert [*table["model"].unique()] == ["mlp", "mlp-ensemble"]
    ensemble_rows = table[table["model"] == "mlp-ensemble"]
    assert set(ensemble_rows["mean"]) == {0.45} and set(ensemble_rows["low"]) == set(
        ensemble_rows["paper"]
    ) == {""}
    assert "| mlp-ensemble | 0.450 | 0.450 |" in (tmp_path / "table_1.md").read_text()


def test_the_latent_loss_is_a_difference_paired_by_seed(tmp_path):
    """Of seeds that differ by much and pairs that differ by 0.01 or so."""
    plain = np.array([0.3, 0.5, 0.7, 0.4, 0.6])
    difference = np.array([0.008, 0.010, 0.012, 0.009, 0.011])
    informed = {"model": "physics-informed-mlp", "seeds": 5}
    seed_texts = [
        ";".join(f"{value:.6g}" for value in values) for values in (plain, plain + difference)
    ]
    write(
        tmp_path,
        metric_file(tmp_path, seeds=5, each=seed_texts[0]),
        metric_file(tmp_path, **informed, each=seed_texts[1]),
    )
    low, high = metrics.interval(difference)
    line = f"| physics-informed-mlp minus mlp | +0.010 [+{low:.3f}, +{high:.3f}] |"
    assert line in (tmp_path / "table_1.md").read_text()


@pytest.mark.parametrize(
    "informed",
    [
        {"each": "1;2;3;4", "seeds": 4},
        {"each": "1;2;3;4;5;6", "seeds": 6},
        {"each": "1;2;3;4;5", "seeds": 5, "model": "physics-informed-cnn"},
        {"each": "1;2;3;4;5", "seeds": 5, "split": "place"},
    ],
)
def test_nothing_is_paired_that_has_no_partner(tmp_path, informed):
    plain = {"each": "1;2;3;4" if informed["seeds"] == 4 else "1;2;3;4;5"}
    plain["seeds"] = len(plain["each"].split(";"))
    informed_columns = {"model": "physics-informed-mlp", **informed}
    write(tmp_path, metric_file(tmp_path, **plain), metric_file(tmp_path, **informed_columns))
    assert "minus mlp" not in (tmp_path / "table_1.md").read_text()


def test_the_limit_stands_beside_its_own_split_alone(tmp_path):
    paths = [metric_file(tmp_path, split=split) for split in ("random", "continuous")]
    table = write(tmp_path, *paths, limits=[limit_file(tmp_path)])
    cell = table.set_index(["split", "target", "metric"])["limit"]
    assert set(cell["random"]) == {""} and set(cell["continuous"]) == {"0.9"}
    text = (tmp_path / "table_1.md").read_text().split("split by continuous")
    assert "limit, skin" not in text[0]
    assert "| limit | 0.900 | 0.900 | 0.900 | 0.900 |" in text[1]
    assert "| limit, skin and gains known | 0.950 |" in text[1]


def test_a_figure_is_drawn_from_the_table_as_the_page_says(tmp_path):
    page = (ROOT / "docs" / "learning.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    tables = tmp_path / "results" / "tables"
    tables.mkdir(parents=True)
    write(tables, metric_file(tmp_path), metric_file(tmp_path, model="my-own"))
    command = [sys.executable, "-c", code]
    subprocess.run(command, cwd=tmp_path, env=os.environ | {"MPLBACKEND": "agg"}, check=True)
    assert (tmp_path / "my_figure.png").stat().st_size > 1000


def test_every_column_has_a_line_of_its_own_on_the_page():
    page = (ROOT / "results" / "README.md").read_text(encoding="utf-8")
    documented = re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)))
    assert {*metrics.COLUMNS, *table_1.TABLE} <= {*documented}


def test_other_files_are_refused(tmp_path):
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match=r"other\.csv: columns: found \['a', 'b'\]"):
        table_1.collect([tmp_path / "other.csv"], PAPER, REPEATED)
    with pytest.raises(InputError, match="metrics files: found none"):
        table_1.collect([], PAPER, REPEATED)
