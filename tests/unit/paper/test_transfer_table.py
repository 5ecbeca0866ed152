import numpy as np
import pandas as pd
import pytest

from eitskin.errors import InputError
from eitskin.learn import metrics, transfer_runs
from eitskin.paper import transfer_table

KEYS = {"target": "bench", "model": "mlp", "budget": "small"}


def runs(values: dict[str, list[float]], variable="F"):
    """Rows of both metrics, a value a run: draws with seeds 1 and 2 in turn, or seeds 1, 2 ..."""
    rows = []
    for method, run_values in values.items():
        drawn = transfer_runs.METHODS[method] == transfer_runs.FEW_LABELS
        for k, value in enumerate(run_values):
            run = (k, 1 + k % 2) if drawn else (-1, 1 + k)
            rows.append((method, *run, 100, variable, "mae", value, ""))
            rows.append((method, *run, 100, variable, "r2", 0.5, ""))
    return pd.DataFrame(rows, columns=list(transfer_runs.RUNS))


def files(folder, source: pd.DataFrame, references: pd.DataFrame):
    run_files = []
    for name, table in (("simulated-authors", source), ("", references)):
        path = folder / f"{name or 'references'}.csv"
        metrics.write(table, path)
        run_files.append(({"source": name, **KEYS}, path))
    return run_files


def small(folder):
    source = {
        "zero-shot": [3.0, 3.2],
        "CORAL": [1.0, 1.24],
        "affine": [1.2, 1.5, 1.3],
        "isotonic": [0.9, 1.0, 0.95],
    }
    references = {
        transfer_runs.CONSTANT: [2.0, 2.1, 2.05],
        transfer_runs.NEAREST: [1.4, 1.6, 1.5],
        transfer_runs.TRAINED_FEW: [1.3, 0.7, 1.0],
        transfer_runs.TRAINED_ALL: [0.4, 0.5],
    }
    return files(folder, runs(source), runs(references))


def test_mean_and_interval_are_those_of_the_runs(tmp_path):
    table = transfer_table.summarise(transfer_table.collect(small(tmp_path)))
    assert list(table.columns) == list(transfer_table.TABLE)
    cell = table[table["metric"] == "mae"].set_index("method")
    affine = cell.loc["affine"]
    assert affine["mean"] == pytest.approx(4 / 3)
    assert (affine["low"], affine["high"]) == pytest.approx(
        metrics.interval(np.array([1.2, 1.5, 1.3]))
    )
    assert (affine["draws"], affine["seeds"], affine["labels"]) == (3, 2, "5 %")
    assert affine["unit"] == "N" and affine["source"] == "simulated-authors"
    zero = cell.loc["zero-shot"]
    assert (zero["low"], zero["high"]) == pytest.approx(metrics.interval(np.array([3.0, 3.2])))
    assert (zero["draws"], zero["seeds"], zero["labels"]) == (0, 2, "none")
    assert cell.loc[transfer_runs.TRAINED_ALL, "source"] == ""
    assert cell.loc[transfer_runs.TRAINED_ALL, "labels"] == "training part"


def one(method: str, values: list[float], source: str) -> pd.DataFrame:
    rows = runs({method: values}).assign(source=source)
    return rows[rows["metric"] == "mae"]


def test_differences_are_of_pairs_where_there_are_any():
    affine = one("affine", [1.0, 2.0, 3.0], "a")
    trained = one(transfer_runs.TRAINED_FEW, [0.9, 1.8, 3.0], "")
    limits = transfer_table.difference(affine, trained)
    assert limits == pytest.approx((0.1, *metrics.interval(np.array([0.1, 0.2, 0.0]))))
    zero = one("zero-shot", [4.0, 4.5], "a")
    limits = transfer_table.difference(affine, zero)  # draws were with the seeds 1, 2, 1
    expected = np.array([-3.0, -2.5, -1.0])
    assert limits == pytest.approx((expected.mean(), *metrics.interval(expected)))
    limits = transfer_table.difference(one("CORAL", [3.0, 4.0], "a"), zero)
    assert limits == pytest.approx((-0.75, *metrics.interval(np.array([-1.0, -0.5]))))


def test_what_nothing_pairs_is_compared_as_independent():
    zero = one("zero-shot", [4.0, 4.5, 3.5], "a")
    constant = one(transfer_runs.CONSTANT, [2.0, 2.1, 1.9, 2.0], "")
    mean, low, high = transfer_table.difference(zero, constant)
    assert mean == pytest.approx(2.0)
    # standard error sqrt(0.25 / 3 + 0.02 / 3 / 4), Welch's degrees of freedom 2.08
    assert (low, high) == pytest.approx((2 - 1.2087, 2 + 1.2087), abs=2e-3)
    mean, low, high = transfer_table.difference(zero[:1], constant)
    assert mean == pytest.approx(2.0) and np.isnan(low) and np.isnan(high)


def test_the_reading_follows_the_numbers(tmp_path):
    collected = transfer_table.collect(small(tmp_path))
    collected = collected[collected["metric"] == "mae"]
    reading = transfer_table.reading(collected, "F")
    assert reading.startswith("**F**: zero-shot errs by 3.10 N, worse than constant (+1.05 N [")
    assert "CORAL is better than zero-shot (-1.98 N [" in reading
    assert "isotonic errs least, 0.95 N, better than zero-shot (-2.12 N" in reading
    assert "not told apart from trained on the 5 % (-0.05 N" in reading
    assert "the 5 % alone give 1.00 N at best (trained on the 5 %)" in reading
    assert reading.endswith("the whole training part 0.45 N.")
    collected.loc[collected["method"] == "isotonic", "value"] += 5.0
    assert "affine errs least, 1.33 N" in transfer_table.reading(collected, "F")
    collected.loc[collected["method"] == transfer_runs.TRAINED_FEW, "value"] += 5.0
    assert "at best (nearest of the 5 %)" in transfer_table.reading(collected, "F")
    collected.loc[collected["method"] == "zero-shot", "value"] = [1.0, 1.02]
    assert "1.01 N, better than constant (-1.04 N" in transfer_table.reading(collected, "F")


def test_table_and_text_say_what_was_left_out(tmp_path):
    source = runs({"zero-shot": [3.0, 3.2]})
    blank = ("", -1, -1, 0, "x", "", np.nan, "the recording's places are in the robot's frame")
    source = pd.concat([source, pd.DataFrame([blank], columns=list(transfer_runs.RUNS))])
    run_files = files(tmp_path, source, runs({transfer_runs.CONSTANT: [2.0, 2.1]}))
    transfer_table.write(run_files, tmp_path / "t.csv", tmp_path / "t.md")
    table = pd.read_csv(tmp_path / "t.csv", keep_default_na=False)
    assert list(table.columns) == list(transfer_table.TABLE)
    (row,) = table[table["left_out"] != ""].to_dict("records")
    assert (row["variable"], row["mean"], row["source"]) == ("x", "", "simulated-authors")
    text = (tmp_path / "t.md").read_text()
    assert "- left out, x: the recording's places are in the robot's frame" in text
    assert "| zero-shot | none | 3.10 [1.83, 4.37] | 0.50 [0.50, 0.50] |" in text


def test_nothing_in_common_is_a_section_with_its_reason_alone(tmp_path):
    blank = ("", -1, -1, 0, "", "", np.nan, "bench: channels: found none")
    source = pd.DataFrame([blank], columns=list(transfer_runs.RUNS))
    run_files = files(tmp_path, source, runs({transfer_runs.CONSTANT: [2.0, 2.1]}))
    transfer_table.write(run_files, tmp_path / "t.csv", tmp_path / "t.md")
    text = (tmp_path / "t.md").read_text()
    section = text.split("### From simulated-authors")[1]
    assert section.strip() == "- left out, everything: bench: channels: found none"


def test_two_sources_share_the_references(tmp_path):
    run_files = small(tmp_path)
    (keys, path), references = run_files
    run_files = [(keys, path), ({**keys, "source": "simulated-corrected-bench"}, path), references]
    table = transfer_table.summarise(transfer_table.collect(run_files))
    assert (table["source"] == "").sum() == 4 * 2
    text = transfer_table.to_markdown(transfer_table.collect(run_files), table)
    section, second = text.split("### From simulated-")[1:]
    assert section.partition("\n")[2].strip() == second.partition("\n")[2].strip()


def test_other_files_are_refused(tmp_path):
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match=r"other\.csv: columns: found \['a', 'b'\]"):
        transfer_table.collect([({"source": "", **KEYS}, tmp_path / "other.csv")])
    with pytest.raises(InputError, match="files of runs: found none"):
        transfer_table.collect([])
