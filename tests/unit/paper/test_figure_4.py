import numpy as np
import pandas as pd
import pytest

from eitskin.data import dataset
from eitskin.errors import InputError
from eitskin.learn import metrics
from eitskin.paper import figure_4
from eitskin.physics.geometry import even_angles
from eitskin.physics.skin import Skin
from eitskin.pins import ROOT

SKIN = Skin(80.0, 3.0, 0.5, tuple(even_angles(16)), 0.0, 0.0, 1e-3, 0.9)


@pytest.fixture
def touches(make_recording):
    return dataset.from_recording(make_recording(presses=12), "bench")


def predicted(touches, error_N, seeds=(3, 4)):
    """Predictions of every sample, off by `error_N` (one a seed), and their metrics."""
    tables = []
    for seed, offset_N in zip(seeds, error_N, strict=True):
        table = touches.table[["sample", "x_mm", "y_mm", "force_N"]].copy()
        table["force_N"] += offset_N
        table.insert(1, "seed", seed)
        tables.append(table.assign(touch=True, abstain=False))
    predictions = pd.concat(tables, ignore_index=True)
    header = {"model": "any", "trained_samples": 9, "budget": {"epochs": 1}}
    return predictions, metrics.evaluate(predictions, touches, "random", "small", header)


def test_worst_and_best_are_by_the_mean_over_the_seeds(touches):
    errors = {"a": (0.1, 0.5), "b": (0.4, 0.4), "c": (0.2, 0.2)}
    rows = {model: predicted(touches, offsets_N)[1] for model, offsets_N in errors.items()}
    choice = figure_4.choose(rows)
    assert (choice.worst, choice.best, choice.models) == ("b", "c", ("a", "b", "c"))
    assert choice.shown == "c" == figure_4.choose(rows, "another").shown
    asked = figure_4.choose(rows, "a")
    assert (asked.worst, asked.best, asked.shown) == ("b", "c", "a")
    assert asked.remarks == ("worst", "best: c") and choice.remarks == ("worst", "best")
    asked = figure_4.choose(rows, "b")
    assert asked.worst == "a"  # never the same twice
    assert asked.remarks == ("worst of the others", "worst of all; best: c")


def test_one_model_and_a_model_without_force_are_refused(touches):
    rows = predicted(touches, (0.1, 0.2))[1]
    with pytest.raises(InputError, match="models: found mlp, expected two or more"):
        figure_4.choose({"mlp": rows})
    with pytest.raises(InputError, match="mae of F: found 0 of them"):
        figure_4.choose({"mlp": rows[rows["target"] != "F"], "cnn": rows})


def test_errors_by_place_are_means_over_samples_and_seeds(touches):
    predictions, _ = predicted(touches, (0.25, -0.75))
    places = figure_4.by_place(figure_4.joined(predictions, touches, "mlp"))
    assert len(places) == touches.table["place"].nunique()
    np.testing.assert_allclose(places["mae_N"], 0.5)
    assert places["samples"].sum() == 2 * len(touches.table)
    place_rows = touches.table[touches.table["place"] == places["place"][0]]
    assert places["x_mm"][0] == pytest.approx(place_rows["x_mm"].mean())


def test_truth_and_prediction_stand_side_by_side(touches):
    predictions, _ = predicted(touches, (0.25, -0.75))
    table = figure_4.joined(predictions, touches, "mlp")
    mean_error = (table["predicted_N"] - table["force_N"]).groupby(table["seed"]).mean()
    np.testing.assert_allclose(mean_error, [0.25, -0.75])


def test_no_place_hides_another_and_the_largest_error_is_told():
    """On the paper's grid, whose innermost places lie 2 mm apart."""
    radius, angle = np.meshgrid(np.linspace(8.0, 72.0, 8), np.arange(24) * np.pi / 12)
    place_mm = (radius * np.exp(1j * angle)).ravel()
    error = np.linspace(0.1, 1.0, len(place_mm))
    columns = {
        "x_mm": place_mm.real,
        "y_mm": place_mm.imag,
        "force_N": 5.0,
        "predicted_N": 5.0 + error,
    }
    table = pd.DataFrame({"model": "mlp", "seed": 1, "place": np.arange(len(place_mm)), **columns})
    axes = figure_4.draw(table, table, SKIN).axes
    (mesh,) = [
        artist for artist in axes[2].collections if len(artist.get_array().compressed()) > 1000
    ]
    value, pixels = np.unique(mesh.get_array().compressed(), return_counts=True)
    np.testing.assert_allclose(value, error)
    assert pixels.min() > 50
    middle = mesh.get_array()[figure_4.ACROSS // 2, -figure_4.ACROSS // 20]
    assert middle == pytest.approx(error[np.abs(place_mm - 76.0).argmin()])
    assert (error > mesh.norm.vmax).mean() == pytest.approx(1 - figure_4.SHOWN, abs=0.005)
    assert any(artist.get_xlabel().endswith("largest 1.00") for artist in axes)
    caption = (ROOT / "workflow" / "report" / "figure_4.rst").read_text(encoding="utf-8")
    assert f"The {1 - figure_4.SHOWN:.0%} of places".replace("%", " %") in caption


def test_files_are_written_and_the_numbers_beside_them(touches, tmp_path):
    models = {}
    for model, offsets_N in {"mlp": (0.1, 0.2), "cnn": (0.5, 0.6), "svr": (0.3, 0.3)}.items():
        predictions, rows = predicted(touches, offsets_N)
        models[model] = rows, tmp_path / f"{model}.parquet"
        predictions.to_parquet(models[model][1])
    files = [tmp_path / f"figure.{kind}" for kind in ("svg", "png", "csv")]
    skin = SKIN.metadata()
    choice = figure_4.write(models, touches, skin, *files, model="svr")
    assert (choice.worst, choice.best, choice.shown) == ("cnn", "mlp", "svr")
    table = pd.read_csv(files[2])
    assert table.groupby("panel")["model"].unique().map(list).to_dict() == {
        "a": ["cnn"],
        "b, c": ["svr"],
    }
    assert all(file.stat().st_size > 1000 for file in files[:2])
    drawn = figure_4.draw(table[:20], table[-20:], SKIN, choice.remarks).axes
    titles = [axes.get_title() for axes in drawn[:2]]
    assert titles == ["(a) cnn\n(worst)", "(b) svr\n(best: mlp)"]


def test_errors_are_drawn_within_an_outline():
    outline = {"corners_mm": [[0, 0], [90, 0], [90, 30], [0, 30]]}
    stated = SKIN.metadata() | {"radius_mm": None, "electrode_deg": None, "outline": outline}
    skin = Skin.from_metadata(stated | {"electrode_s": [0.1, 0.3, 0.6, 0.9]})
    x_mm = np.linspace(10.0, 80.0, 5)
    columns = {"x_mm": x_mm, "y_mm": 15.0, "force_N": 5.0, "predicted_N": 5.1 + 0.1 * np.arange(5)}
    table = pd.DataFrame({"model": "mlp", "seed": 1, "place": np.arange(5), **columns})
    axes = figure_4.draw(table, table, skin).axes[2]
    (mesh,) = [artist for artist in axes.collections if len(artist.get_array().compressed()) > 1000]
    drawn = ~np.ma.getmaskarray(mesh.get_array())
    assert drawn.mean() == pytest.approx(1.0 / 3.0, abs=0.01)
    assert axes.get_xlim()[0] < 0.0 and axes.get_xlim()[1] > 90.0
