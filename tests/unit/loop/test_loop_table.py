import json

import numpy as np
import pandas as pd
import pytest

from eitskin.errors import InputError
from eitskin.learn import metrics, transfer_runs
from loop import figure, table
from loop.naming import AUTHORS, BELIEF, DIAGNOSIS, LABELS, TRUTH

ERRORS = {  # of F, by seed
    BELIEF: [2.0, 2.2, 2.4],
    DIAGNOSIS: [0.9, 1.0, 1.1],
    TRUTH: [0.7, 0.8, 0.9],
    LABELS: [1.5, 1.4, 1.6],
}


def rows(values, method):
    row_list = []
    for seed, value in enumerate(values, start=1):
        for variable, factor in (("x", 2.0), ("y", 4.0), ("F", 1.0)):
            for metric in ("mae", "rmse"):
                run = (method, -1, seed, 0, variable, metric, factor * value, "")
                row_list.append(run)
    return row_list


def files(folder, errors=ERRORS):
    listed = []
    for source, values in errors.items():
        method = transfer_runs.TRAINED_FEW if source == LABELS else transfer_runs.ZERO_SHOT
        run_rows = rows(values, method)
        if source == BELIEF:
            run_rows += rows([1.2, 1.3, 1.1], "CORAL")
        path = folder / f"{source}.csv"
        metrics.write(pd.DataFrame(run_rows, columns=list(transfer_runs.RUNS)), path)
        listed.append(({"case": "bench", "model": "mlp", "source": source}, path))
    return listed


def cell(summary, source, variable="F", method=transfer_runs.ZERO_SHOT):
    is_cell = (summary["source"] == source) & (summary["variable"] == variable)
    is_cell &= (summary["metric"] == "mae") & (summary["method"] == method)
    (index,) = np.flatnonzero(is_cell)
    return summary.iloc[index]


def test_differences_are_paired_by_seed(tmp_path):
    summary = table.summarise(table.collect(files(tmp_path)))
    row = cell(summary, DIAGNOSIS)
    assert (row["mean"], row["saved"], row["seeds"]) == (pytest.approx(1.0), pytest.approx(1.2), 3)
    # differences 1.1, 1.2, 1.3: standard error 0.1 / sqrt 3, t of two degrees of freedom 4.3027
    assert row["saved_high"] - row["saved"] == pytest.approx(4.3027 * 0.1 / np.sqrt(3), rel=1e-4)
    assert row["saved_share"] == pytest.approx(1.2 / 2.2)
    assert np.isnan(cell(summary, BELIEF)["saved"])
    alone = cell(summary, LABELS, method=transfer_runs.TRAINED_FEW)
    assert alone["saved"] == pytest.approx(0.7)


def test_the_place_s_error_is_the_mean_of_both_coordinates(tmp_path):
    summary = table.summarise(table.collect(files(tmp_path)))
    row = cell(summary, TRUTH, table.PLACE)
    assert row["mean"] == pytest.approx(3 * 0.8) and row["unit"] == "mm"


def test_what_is_closed_is_told_where_there_is_something_to_close(tmp_path):
    share = table.closed_shares(table.collect(files(tmp_path))).set_index("variable")
    assert share.loc["F", "truth_saves"] == pytest.approx(1.4 / 2.2)
    assert share.loc["F", "closed"] == pytest.approx(1.2 / 1.4)
    little = {**ERRORS, TRUTH: [1.9, 2.1, 2.3]}
    share = table.closed_shares(table.collect(files(tmp_path, little))).set_index("variable")
    assert share.loc["F", "truth_saves"] == pytest.approx(0.1 / 2.2)
    assert np.isnan(share.loc["F", "closed"])


def cases(folder, number, truth_saves=True):
    listed = []
    for k in range(number):
        errors = {
            BELIEF: [2.0, 2.2, 2.4],
            AUTHORS: [1.6, 1.8, 2.0 + k],
            DIAGNOSIS: [0.9, 1.0, 1.1 + 0.1 * k],
            TRUTH: [0.7, 0.8, 0.9] if truth_saves else [1.9, 2.1, 2.3],
        }
        case_folder = folder / str(k)
        case_folder.mkdir()
        listed += [
            ({**keys, "case": case_folder.name}, path) for keys, path in files(case_folder, errors)
        ]
    return listed


def test_what_a_diagnosis_is_worth_is_counted_over_cases_where_the_truth_is(tmp_path):
    runs = table.collect(cases(tmp_path, 2))
    worth = table.worth(runs, table.closed_shares(runs)).set_index("against")
    belief = np.array([1.2 / 2.2, (2.2 - 3.1 / 3) / 2.2])
    assert worth.loc[BELIEF, "cases"] == 2 and worth.loc[BELIEF, "sure"] == 2
    assert worth.loc[BELIEF, "saved"] == pytest.approx(belief.mean())
    # two cases: t of one degree of freedom 12.706
    half = 12.7062 * np.ptp(belief) / 2
    assert worth.loc[BELIEF, "high"] - worth.loc[BELIEF, "saved"] == pytest.approx(half, rel=1e-4)
    # the second case's differences 0.7, 0.8, 1.8 are no certain gain over the generic ones
    assert worth.loc[AUTHORS, "sure"] == 1
    assert worth["over_truth"].tolist() == pytest.approx([(1.25 + 3.1 / 2.4) / 2] * 2)


def test_where_the_truth_saves_little_nothing_is_claimed(tmp_path):
    runs = table.collect(cases(tmp_path, 2, truth_saves=False))
    worth = table.worth(runs, table.closed_shares(runs))
    assert worth["cases"].tolist() == worth["sure"].tolist() == [0, 0]
    assert worth[["saved", "over_truth"]].isna().all(axis=None)


def test_the_text_names_what_was_concealed_and_found(tmp_path):
    law = {"name": "contact-law", "parameters": {"exponent": 0.7}}
    (tmp_path / "truth.json").write_text(json.dumps({"effects": [law]}))
    (tmp_path / "diagnosis").mkdir()
    named = {"name": "contact-law", "parameters": {"exponent": {"value": 0.7012}}}
    diagnosis = {"verdict": "explained", "effects": [named]}
    (tmp_path / "diagnosis" / "diagnosis.json").write_text(json.dumps(diagnosis))
    csv, text = tmp_path / "loop.csv", tmp_path / "loop.md"
    table.write(files(tmp_path), {"bench": tmp_path}, csv, text)
    written = text.read_text()
    assert "| bench | contact-law (exponent 0.7) | contact-law (exponent 0.701) |" in written
    assert "1.20 [0.95, 1.45] | 64 % | 86 % |" in written
    assert "| mlp | belief | 1 | 55 % | 1 | 1.25 |" in written
    assert "| bench | belief | 2.20 [1.70, 2.70] | 1.20 [0.95, 1.45] |" in written
    assert list(pd.read_csv(csv).columns) == list(table.TABLE)


def test_the_figure_shows_every_source_of_its_model(tmp_path):
    svg, png, csv = (tmp_path / f"mlp.{suffix}" for suffix in ("svg", "png", "csv"))
    summary = tmp_path / "loop.csv"
    table.summarise(table.collect(files(tmp_path))).to_csv(summary, index=False)
    figure.write(summary, "mlp", svg, png, csv)
    drawn = pd.read_csv(csv)
    assert set(drawn["source"]) == set(ERRORS) and set(drawn["variable"]) == {"F", table.PLACE}
    assert svg.read_text().startswith("<?xml") and png.stat().st_size > 1000


def test_cases_are_told_without_their_seeds_and_what_was_not_measured_is_told():
    cases = ["single-relaxation-600001", "single-relaxation-600002", "hydrogel-skin-16"]
    rows = [
        {"case": case, "variable": variable, "source": BELIEF, "mean": 2.0, "low": 1.0, "high": 3.0}
        for case in cases
        for variable in ("F", table.PLACE)
        if variable != "F" or case in cases[:2]
    ]
    force, place = figure.draw(pd.DataFrame(rows)).axes
    names = [label.get_text() for label in force.get_yticklabels()]
    assert names == ["single-relaxation", "single-relaxation, 2", "hydrogel-skin-16"]
    assert [text.get_text() for text in force.texts] == ["not measured"] and not place.texts


def test_another_file_is_refused(tmp_path):
    path = tmp_path / "other.csv"
    path.write_text("a,b\n1,2\n")
    keys = {"case": "bench", "model": "mlp", "source": BELIEF}
    with pytest.raises(InputError, match="columns"):
        table.collect([(keys, path)])
    with pytest.raises(InputError, match="none"):
        table.collect([])
