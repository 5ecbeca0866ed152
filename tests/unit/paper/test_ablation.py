import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from eitskin.paper import ablation, tuning

TRAINING = {"learning_rate": 0.001, "latent_dim": 16, "lambda_latent": 0.03, "force_weight": 5.0}


def by_seed(values, metric="mae", target="F"):
    """Rows of `metrics.by_seed` with a value a seed."""
    rows = [(target, metric, seed, value) for seed, value in enumerate(values, 1)]
    return pd.DataFrame(rows, columns=["target", "metric", "seed", "value"])


def test_one_choice_is_varied_and_its_default_is_shared():
    varied = {"lambda_latent": [0.0, 0.03], "latent_dim": [4, 16], "samples": [750, None]}
    default = {**TRAINING, "samples": None}
    named = ablation.settings(default, varied)
    assert named == {
        "default": {},
        "lambda_latent-0": {"lambda_latent": 0.0},
        "latent_dim-4": {"latent_dim": 4},
        "samples-750": {"samples": 750},
    }
    listed = ablation.studies(default, varied)
    assert [key for key, _, _ in listed] == ["lambda_latent"] * 2 + ["latent_dim"] * 2 + [
        "samples"
    ] * 2
    assert all((default | named[name])[key] == value for key, value, name in listed)


def test_only_what_a_teacher_depends_on_needs_other_teachers():
    varied = {"lambda_latent": [0.1], "latent_dim": [4], "force_weight": [1.0], "samples": [750]}
    named = ablation.settings({**TRAINING, "samples": 6000}, varied)
    settings_with_teachers = {name for name in named if ablation.has_own_teachers(name)}
    assert settings_with_teachers == {"latent_dim-4", "samples-750"}


def test_the_grid_has_every_combination_once_in_whatever_order_it_is_written():
    axes = {"learning_rate": [0.001, 0.003], "force_weight": [1.0, 5.0, 20.0]}
    grid = ablation.grid(axes, [64, 32])
    points = {(item["learning_rate"], item["force_weight"]) for item in grid.values()}
    assert points == set(itertools.product(*axes.values())) and len(grid) == 6
    assert all(item["widths"] == [64, 32] for item in grid.values())
    assert grid == ablation.grid(dict(reversed(axes.items())), [64, 32])
    assert not grid.keys() & ablation.grid(axes, [64]).keys()
    assert not any(ablation.has_own_teachers(name) for name in grid)


def test_a_tenth_less_of_any_target_s_error_counts_alike():
    def scored(x, force):
        return pd.concat([by_seed([x, x], target="x"), by_seed([force, force])])

    reference_score = ablation.score(scored(2.0, 0.5))
    assert reference_score == pytest.approx(1.0)
    assert ablation.score(scored(1.8, 0.5)) == pytest.approx(ablation.score(scored(2.0, 0.45)))
    scores = {"a": scored(2.0, 0.5), "b": scored(2.2, 0.4), "c": scored(2.2, 0.4)}
    assert ablation.best(scores) == "b"


def test_points_of_a_grid_make_a_table_with_the_best_of_each_model_marked(tmp_path):
    model_columns = {"dataset": "a set", "split": "random"}
    point = {"widths": [64, 32], "learning_rate": 1e-3, "weight_decay": 0.0, "force_weight": 1.0}
    rows = [
        tuning.row(by_seed(values), {**model_columns, "model": model}, point, "full")
        for model, values in (("mlp", [0.5, 0.7]), ("mlp", [0.5, 0.6]), ("cnn", [0.9, 0.9]))
    ]
    tuning.write(rows, tmp_path / "tuning.csv")
    table = pd.read_csv(tmp_path / "tuning.csv")
    assert list(table) == list(tuning.TUNING)
    assert table["score"].tolist() == [0.6, 0.55, 0.9] and table["best"].tolist() == [0, 1, 1]
    assert table["widths"].fillna("").tolist() == ["64x32", "64x32", ""]
    assert set(table["seeds"]) == {2}


@settings(max_examples=25)
@given(st.lists(st.tuples(st.floats(0, 9), st.floats(0, 9)), min_size=5, max_size=9))
def test_a_difference_is_paired_by_seed(values):
    plain, informed = np.array(values).T
    shuffled = by_seed(informed).sample(frac=1, random_state=1)
    (row,) = ablation.compared_rows(by_seed(plain), shuffled, {"dataset": "a set"})
    difference = informed - plain
    assert row["difference"] == pytest.approx(difference.mean(), abs=1e-12)
    assert (row["plain"], row["informed"]) == pytest.approx((plain.mean(), informed.mean()))
    if np.ptp(difference) > 1e-9:
        expected = stats.ttest_rel(informed, plain).confidence_interval(0.95)
        assert (row["low"], row["high"]) == pytest.approx(tuple(expected), abs=1e-9)


def test_pairs_that_are_none_are_refused():
    with pytest.raises(ValueError, match="differ in their seeds"):
        ablation.compared_rows(by_seed([1.0, 2.0]), by_seed([1.0, 2.0, 3.0]), {})


@pytest.mark.parametrize(
    ("metric", "low", "high", "words"),
    [
        ("mae", -0.2, -0.1, "helps"),
        ("mae", 0.1, 0.2, "harms"),
        ("r2", 0.1, 0.2, "helps"),
        ("r2", -0.2, -0.1, "harms"),
        ("r2", -0.1, 0.1, "no difference that 10 seeds can tell"),
        ("mae", 0.0, 0.0, "no difference that 10 seeds can tell"),
    ],
)
def test_a_verdict_follows_from_the_interval(metric, low, high, words):
    assert ablation.verdict(metric, low, high, 10) == words


def test_fewer_than_five_seeds_tell_nothing():
    nan = float("nan")
    assert ablation.verdict("mae", nan, nan, 1) == "cannot be told from 1 seed"
    assert ablation.verdict("mae", nan, nan, 4) == "cannot be told from 4 seeds"


def test_tables_are_written_with_their_columns(tmp_path):
    place = {"dataset": "a set", "split": "random", "budget": "small"}
    values = [0.5, 0.7, 0.6, 0.6, 0.6]
    varied = ablation.varied_rows(by_seed(values), {"study": "samples", "value": None, **place})
    tuned = {"plain_setting": "force weight 1", "informed_setting": "force weight 5"}
    plain, informed = [0.5, 0.52, 0.51, 0.51, 0.51], [0.4, 0.43, 0.42, 0.41, 0.415]
    setting_columns = place | tuned | {"widths": "64x32"}
    compared = ablation.compared_rows(by_seed(plain), by_seed(informed), setting_columns)
    paths = [tmp_path / name for name in ("ablation.csv", "latent_loss.csv", "ablation.md")]
    ablation.write(varied, compared, *paths)
    assert list(pd.read_csv(paths[0])) == list(ablation.VARIED)
    assert list(pd.read_csv(paths[1])) == list(ablation.COMPARED)
    row = pd.read_csv(paths[0]).iloc[0]
    assert (row["value"], row["model"], row["mean"], row["unit"]) == (
        "all",
        "physics-informed-mlp",
        0.6,
        "N",
    )
    text = paths[2].read_text(encoding="utf-8")
    assert "| samples | all | 0.600 [" in text
    assert "mlp force weight 1, physics-informed-mlp force weight 5" in text
    expected = stats.ttest_rel(informed, plain).confidence_interval(0.95)
    assert f"| 0.510 | 0.415 | -0.0950 [{expected.low:+.4f}, {expected.high:+.4f}] | helps" in text
    assert (
        "Of 1 differences with an interval, 1 say that the latent loss helps, 0 that it harms"
        in text
    )
    ablation.write([], [], *paths)
    assert "latent loss" not in paths[2].read_text(encoding="utf-8")  # nothing was compared
    assert list(pd.read_csv(paths[0])) == list(ablation.VARIED)
