"""The rectangular skin of workflow/config/rectangle.yaml from its twin to a table of errors."""

import pandas as pd
import pytest
import yaml

from eitskin.data import dataset, recording
from eitskin.physics.skin import Skin

RECTANGLE = "workflow/config/rectangle.yaml"
FEW = {
    "touch_grid": {"spacing_mm": 26.0},
    "forces": {"levels": 6},
    "twin": {"touch_grid": {"spacing_mm": 26.0}},
    "configurations": {
        "tiny": {
            "effects": [{"name": "ellipse", "parameters": {"sx": {"sd": 0.01}, "sy": 1.0}}],
            "session_frames": 12,
        }
    },
    "budgets": {"small": {"epochs": 2, "seeds": 1}},
    "table_1": {
        "configurations": {"tiny": ["session"]},
        "recordings": {"simulated-twin": {"random": ["mlp"]}},
    },
    "models": ["mlp"],
    "figures": {"configuration": "tiny"},
}


@pytest.mark.long
def test_a_rectangle_is_recorded_simulated_and_learned_from(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    (house.folder / "few.yaml").write_text(yaml.safe_dump(FEW), encoding="utf-8")
    run = house.snakemake(RECTANGLE, "few.yaml", "--", "table_1", cores=1)
    assert run.returncode == 0, run.stdout + run.stderr
    results = house.folder / "results"
    twin = recording.read(results / "twin" / "simulated-twin.parquet")
    stated = yaml.safe_load((house.folder / RECTANGLE).read_text(encoding="utf-8"))["skin"]
    shape = Skin.from_metadata({**twin.metadata["skin"], **stated})
    assert twin.skin.outline == shape.outline and twin.skin.radius_mm is None
    touched = twin.frames[twin.frames["touch"]]
    assert touched[["x_mm", "y_mm"]].abs().max().tolist() == [65.0, 26.0]
    simulated = dataset.read(results / "datasets" / "simulated-tiny.parquet")
    assert simulated.delta_V.shape == (6 * 3 * 6, 24 * 21)
    table = pd.read_csv(results / "tables" / "table_1.csv")
    errors = table[table["metric"] == "mae"].set_index(["split", "target"])["mean"]
    assert set(errors.index.get_level_values("split")) == {"random", "session"}
    assert (errors.dropna() > 0.0).all()
