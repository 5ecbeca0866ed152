"""The ablation, run in small."""

import pandas as pd
import pytest

pytestmark = [pytest.mark.xdist_group("finished"), pytest.mark.long]

TABLES = "results/tables"


@pytest.fixture(scope="module")
def house(finished, tmp_path_factory):
    house = finished.copy(tmp_path_factory.mktemp("ablation") / "house")
    run = house.snakemake("--", "ablation", "tuning")
    assert run.returncode == 0, run.stdout + run.stderr
    return house


def test_every_value_has_its_rows(house):
    varied = pd.read_csv(house.folder / TABLES / "ablation.csv")
    assert [*varied[["study", "value"]].drop_duplicates().itertuples(False, None)] == [
        ("lambda_latent", 0.0),
        ("lambda_latent", 0.03),
        ("latent_dim", 4.0),
    ]
    assert set(varied["target"]) == {"x", "y", "F"} and set(varied["metric"]) == {
        "r2",
        "mae",
        "rmse",
    }
    compared = pd.read_csv(house.folder / TABLES / "latent_loss.csv")
    assert len(compared) == 18 and compared["plain_setting"].str.contains("force weight").all()
    assert [*compared["widths"].drop_duplicates()] == ["16", "32x16"]
    tuned = pd.read_csv(house.folder / TABLES / "tuning.csv")
    assert tuned.groupby("model").size().to_dict() == {"autoencoder-mlp": 4, "mlp": 4}
    assert (tuned.groupby("model")["best"].sum() >= 1).all()


def test_without_the_latent_loss_it_is_the_plain_model(house):
    varied = pd.read_csv(house.folder / TABLES / "ablation.csv")
    none = varied[(varied["study"] == "lambda_latent") & (varied["value"] == 0)]
    found = pd.read_csv(house.folder / "results/metrics/simulated-tiny/session/small/mlp.csv")
    both = none.merge(found, on=["target", "metric"], suffixes=("", "_plain"))
    assert len(both) == 9
    assert both["mean"].to_numpy() == pytest.approx(both["mean_plain"].to_numpy(), rel=1e-5)


def test_what_it_is_made_of_is_not_made_again(house):
    plan = house.snakemake("--dry-run", "--", "ablation", "tuning")
    assert "Nothing to be done" in plan.stdout + plan.stderr
