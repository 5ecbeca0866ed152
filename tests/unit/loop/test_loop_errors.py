import json

import numpy as np
import pandas as pd
import pytest

from eitskin.data import dataset, recording, splits
from eitskin.learn import transfer_runs
from eitskin.learn.train import Budget, Optimiser, Recipe, Split
from eitskin.simulate.imitation import PressPrior, imitated_presses
from loop import errors, labelled
from loop.naming import AUTHORS, BELIEF, DIAGNOSIS, LABELS, TRUTH, cases_by_name
from loop_skin import FORCES, JITTER, LAW
from small_skin import SKIN, small_recording


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A case as the rules before `loop_errors` leave it."""
    folder = tmp_path_factory.mktemp("case")
    recorded = small_recording(LAW, places=40)
    target = dataset.from_recording(recorded, "bench")
    labelled.write(recorded, target, folder, 1)
    (folder / "truth.json").write_text(json.dumps({"true": SKIN.metadata(), "effects": [LAW]}))
    diagnosis_folder = folder / "diagnosis"
    diagnosis_folder.mkdir()
    (diagnosis_folder / "diagnosis.json").write_text(json.dumps({"calibration": {}, "effects": []}))
    twin = {"twin": {"skin": SKIN.metadata(), "effects": [LAW]}}
    (diagnosis_folder / "effects.yaml").write_text(json.dumps(twin))  # which is YAML
    return folder


def parts(folder):
    target = dataset.read(folder / "target.parquet")
    return target, splits.read(folder / "split.parquet", target.table)


def run(folder, source):
    return both(source, folder, *parts(folder))


def both(source, folder, target, part):
    """Errors of two seeds."""
    recipe = Recipe(Optimiser(), Budget(150, 2), 5.0)
    case = errors.Case(folder, Split(target, part), [JITTER], PressPrior(FORCES, 8.0))
    runs = [errors.errors(case, source, "mlp", recipe, 1 + k, k) for k in range(2)]
    return pd.concat(runs, ignore_index=True)


def test_a_diagnosis_sees_no_tested_touch_and_few_labels(folder):
    target, part = parts(folder)
    shown_recording = recording.read(folder / "recording.parquet")
    touched = shown_recording.frames[shown_recording.frames["touch"]]
    labels = target.table[part == "train"]
    columns = ["x_mm", "y_mm", "force_N"]
    np.testing.assert_array_equal(touched[columns], labels[columns])
    assert 0 < len(labels) <= 0.1 * (part != "test").sum()
    places = {*target.table["place"][part == "test"]}
    assert places and not places & {*target.table["place"][part != "test"]}
    free = [k for k in range(40) if k not in places]  # places are presses here
    untouched = ~shown_recording.frames["touch"]
    assert untouched.sum() == len(free) + 4 * (0 in free)
    pressed = np.unique(labels["place"])
    imitated = shown_recording.frames["note_imitated"].astype(bool)
    assert imitated[~untouched].all() and imitated[untouched].sum() == len(pressed)
    imitated_frames = imitated_presses(
        shown_recording, 1, np.random.default_rng(1), PressPrior(FORCES, 8.0)
    )
    assert (~imitated_frames["touch"]).sum() == len(pressed)


@pytest.mark.parametrize("source", [BELIEF, AUTHORS, DIAGNOSIS, TRUTH])
def test_every_source_gives_errors_for_every_seed(folder, source):
    rows = run(folder, source)
    assert set(rows["seed"]) == {1, 2} and set(rows["left_out"]) == {""}
    plain = rows[(rows["method"] == transfer_runs.ZERO_SHOT) & (rows["metric"] == "mae")]
    assert sorted(plain["variable"]) == ["F", "F", "x", "x", "y", "y"]
    assert plain["value"].nunique() == 6 and np.isfinite(plain["value"]).all()
    assert {"CORAL", "affine", "isotonic"} < set(rows["method"])
    assert set(rows.loc[rows["method"] == "affine", "labelled_frames"]) == {
        (parts(folder)[1] == "train").sum()
    }


def test_labels_alone_are_the_reference_where_they_are_enough(folder):
    rows = run(folder, LABELS)
    assert set(rows["method"]) == {transfer_runs.TRAINED_FEW}
    assert rows["left_out"].str.contains("no spread").all()
    target, part = parts(folder)
    part = np.where(part == "validation", "train", part)
    rows = both(LABELS, folder, target, part)
    assert set(rows["seed"]) == {1, 2} and set(rows["left_out"]) == {""}


def test_cases_are_named_by_kind_and_seed():
    assert cases_by_name({"single:contact-law": [3], "pair": [1, 2]}) == {
        "single-contact-law-3": ("single:contact-law", 3),
        "pair-1": ("pair", 1),
        "pair-2": ("pair", 2),
    }
