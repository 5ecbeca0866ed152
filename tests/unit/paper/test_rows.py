import copy

import pandas as pd
import pytest
import yaml

from eitskin.configuration import with_continuous
from eitskin.paper.rows import PAPER, digest, repeated, rows
from eitskin.pins import ROOT

PAPERS = ("simulated-authors", "random")


def test_a_list_of_splits_has_all_models_and_a_mapping_its_own():
    config = {
        "models": ["mlp", "svr"],
        "table_1": {
            "configurations": {
                "text": ["random"],
                "authors": {"random": ["cnn"], "place": ["mlp"]},
            },
            "recordings": {"bench-top": ["place"], "read-only": []},
        },
    }
    assert rows(config) == [
        ("simulated-text", "random", "mlp"),
        ("simulated-text", "random", "svr"),
        ("simulated-authors", "random", "cnn"),
        ("simulated-authors", "place", "mlp"),
        ("bench-top", "place", "mlp"),
        ("bench-top", "place", "svr"),
    ]


def test_every_row_of_the_papers_table_is_made_of_its_own_experiment():
    file = ROOT / "workflow" / "config" / "paper.yaml"
    config = yaml.safe_load(file.read_text(encoding="utf-8"))
    paper = pd.read_csv(ROOT / "workflow" / "eitskin" / "paper" / "printed_table_1.csv")
    trained_models = {model for dataset, split, model in rows(config) if (dataset, split) == PAPERS}
    assert set(paper["model"]) <= trained_models


@pytest.fixture
def shipped():
    config = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
    config["table_1"]["configurations"] = {name: ["random"] for name in config["configurations"]}
    return config


def test_the_shipped_configurations_repeat_the_papers_experiment(shipped):
    assert {name: digest(shipped, name) for name in PAPER} == PAPER
    assert repeated(shipped) == ["authors", "text"]
    derived = {**shipped, "configurations": with_continuous(shipped)}
    assert repeated(derived) == ["authors", "text"]


def test_the_experiment_is_known_by_its_content_whatever_it_is_called(shipped):
    shipped["configurations"]["mine"] = copy.deepcopy(shipped["configurations"]["text"])
    shipped["table_1"]["configurations"] = {"mine": ["random"]}
    shipped["skin"]["radius_mm"] = 80
    assert repeated(shipped) == ["mine"]


@pytest.mark.parametrize(
    "place",
    [
        ("skin", "radius_mm"),
        ("skin", "electrode_deg"),
        ("protocol", "drive"),
        ("touch_grid", "radii"),
        ("forces", "levels"),
        ("configurations", "authors", "noise"),
        ("configurations", "authors", "effects"),
        ("configurations", "authors", "baseline"),
    ],
)
def test_another_experiment_of_the_same_name_does_not_repeat_the_papers(shipped, place):
    *folders, key = place
    block = shipped
    for folder in folders:
        block = block[folder]
    old = block[key]
    new = "opposite" if isinstance(old, str) else old[::2] if isinstance(old, list) else 2 * old
    block[key] = new
    unchanged = ["text"] if place[:2] == ("configurations", "authors") else []
    assert repeated(shipped) == unchanged
