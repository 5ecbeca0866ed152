import pandas as pd
import yaml

from eitskin.paper.rows import rows
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
    made = {model for dataset, split, model in rows(config) if (dataset, split) == PAPERS}
    assert set(paper["model"]) <= made
