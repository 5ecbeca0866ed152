"""What a change makes the workflow do again, and what not."""

import shutil

import pytest

from eitskin.learn import model_file
from sample_files import logger, parquet

pytestmark = pytest.mark.xdist_group("finished")

MODELS = "models: [mlp, physics-informed-mlp]\n"


@pytest.fixture
def house(finished, tmp_path):
    """A finished workflow to edit."""
    return finished.copy(tmp_path / "house")


def of(files, name):
    """The files that belong to one dataset."""
    return {file for file in files if name in file}


def test_after_a_run_nothing_is_to_be_done(finished):
    assert finished.pending() == set()
    plan = finished.snakemake("--dry-run")
    assert plan.returncode == 0
    assert "Nothing to be done" in plan.stdout + plan.stderr


def test_all_can_be_planned_anew(finished):
    plan = finished.snakemake("--dry-run", "--forceall", "--quiet", "rules")
    assert plan.returncode == 0
    jobs = [line.split() for line in (plan.stdout + plan.stderr).splitlines()]
    assert max(int(words[1]) for words in jobs if words[:1] == ["total"]) > 20


@pytest.fixture(scope="module")
def grid_file(tmp_path_factory):
    """A grid of touches that make three of the paper's sessions, as the tiny one does not."""
    path = tmp_path_factory.mktemp("grid") / "grid.yaml"
    path.write_text("touch_grid: {radii: 10, angles: 40}\n")
    return str(path)


def test_the_paper_can_be_planned_at_the_full_budget(finished, grid_file):
    full = ("workflow/config/paper.yaml", "workflow/config/full.yaml", grid_file)
    plan = finished.snakemake(*full, "--dry-run", "--", "paper")
    assert plan.returncode == 0, plan.stderr
    said = plan.stdout + plan.stderr
    assert "/random/full/mlp/10.pt" in said and "/random/full/cnn/5.pt" in said
    assert "/random/full/cnn/6.pt" not in said and "/random/full/svr/2.pt" not in said


def test_an_exported_predictor_can_be_planned(fresh):
    target = "results/exported/simulated-tiny/session/small/mlp.npz"
    assert {"split", "train_predictor", "export"} <= fresh.jobs(target)


@pytest.mark.parametrize(
    ("file", "target", "made"),
    [
        (
            "latent_loss",
            "results/tables/latent_loss.csv",
            "results/ablation/simulated-authors/session/full/tuned-32x16/mlp.csv",
        ),
        (
            "authors_recipe",
            "results/metrics/simulated-authors/random/authors-recipe/physics-informed-mlp.csv",
            "results/models/simulated-authors/random/authors-recipe/regressor/3.pt",
        ),
    ],
)
def test_a_configuration_of_its_own_can_be_planned(finished, grid_file, file, target, made):
    files = f"workflow/config/{file}.yaml", grid_file
    plan = finished.snakemake(*files, "--dry-run", "--", target)
    assert plan.returncode == 0, plan.stderr
    assert made in plan.stdout + plan.stderr


def modules(house):
    """Every file of Python in the workflow, the scripts among them."""
    return sorted((house.folder / "workflow").rglob("*.py"))


def test_comments_and_docstrings_rerun_nothing(house):
    for module in modules(house):
        code = module.read_text(encoding="utf-8").replace('"""\n', ' Told anew."""\n', 1)
        module.write_text(f"# A comment.\n{code}\n# Another.\n")
    assert house.pending() == set()


@pytest.mark.parametrize("kept", ["results and records", "results alone"])
def test_a_fresh_clone_beside_kept_results_plans_nothing(house, kept):
    for file in (house.folder / "workflow").rglob("*"):
        file.touch()
    for name in ("Snakefile", "config.yaml", "tiny.yaml"):
        (house.folder / name).touch()
    if kept == "results alone":
        shutil.rmtree(house.folder / ".snakemake")
    assert house.pending() == set()


LEARNING = {"train_autoencoder", "train_regressor", "train_predictor"}
TABLE = {"evaluate", "table_1"}
DIAGNOSIS = {"diagnose", "diagnosis_report"}
SCORE = {"concealed_score", "concealed_figures", "concealed_case"}  # of a block that is sealed


@pytest.mark.parametrize(
    ("like", "rules"),
    [("crosstalk", {*DIAGNOSIS, *SCORE}), ("ellipse", set())],
    ids=["one that a diagnosis may name", "one composed of others"],
)
def test_a_new_effect_reruns_what_a_diagnosis_may_name(house, like, rules):
    effects = house.folder / "workflow" / "eitskin" / "effects"
    code = (effects / f"{like}.py").read_text(encoding="utf-8").replace(f'"{like}"', '"new"')
    (effects / "new.py").write_text(code, encoding="utf-8")
    assert house.jobs() == rules


@pytest.mark.long
def test_a_style_of_one_figure_redraws_it_alone(house):
    drawn = house.snakemake("--", "figure_1", "figure_4")
    assert drawn.returncode == 0, drawn.stderr
    assert house.jobs("figure_1", "figure_4") == set()
    house.edit("workflow/eitskin/paper/figure_4.py", "FULL_MM, 62.0", "FULL_MM, 63.0")
    assert house.jobs("figure_1", "figure_4") == {"figure_4"}


def test_what_is_other_for_a_model_reaches_it(finished):
    folder = "results/models/simulated-tiny/session/small"
    found = {
        name: model_file.read(finished.folder / folder / name / "1.pt").header
        for name in ("autoencoder", "mlp", "physics-informed-mlp")
    }
    decay = {name: header["optimiser"]["weight_decay"] for name, header in found.items()}
    assert decay == {"autoencoder": 1e-4, "mlp": 3e-4, "physics-informed-mlp": 3e-4}
    assert found["mlp"]["widths"] == [32, 16] and found["mlp"]["budget"]["epochs"] == 2


@pytest.mark.long
def test_support_vectors_know_neither_adam_nor_epochs(house):
    svr = "results/metrics/simulated-tiny/session/small/svr.csv"
    assert house.snakemake("--", svr).returncode == 0
    house.edit("config.yaml", "weight_decay: 0.0001\n  batch", "weight_decay: 0.0002\n  batch")
    budget = "small: {samples: null, epochs: 2, seeds: 2}"
    house.edit("tiny.yaml", budget, budget.replace("2", "3"))
    assert house.jobs(svr) == set()


@pytest.mark.parametrize(
    ("model", "teachers"),
    [
        ("svr", set()),
        ("autoencoder-mlp", {"autoencoder"}),
        ("physics-informed-cnn", {"autoencoder", "regressor"}),
    ],
)
def test_a_model_is_trained_after_the_teachers_it_needs(fresh, tmp_path, model, teachers):
    house = fresh.copy(tmp_path / "house")
    house.edit("tiny.yaml", MODELS, f"models: [{model}]\n")
    folder = "results/models/simulated-tiny/session/small"
    plan = house.snakemake("--summary", f"{folder}/{model}/2.pt")
    assert plan.returncode == 0, plan.stderr
    planned = {line.split("\t")[0] for line in plan.stdout.splitlines()}
    assert of(planned, folder) == {f"{folder}/{name}/2.pt" for name in teachers | {model}}


def test_another_source_of_a_transfer_trains_its_model_and_nothing_twice(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    sets = ["simulated-tiny", "simulated-corrected-bench"]
    house.edit("tiny.yaml", "sources: [simulated-tiny]", f"sources: [{', '.join(sets)}]")
    house.edit("tiny.yaml", "configurations:\n  tiny:", "configurations:\n  corrected-bench: &tiny")
    house.edit("tiny.yaml", MODELS, "models: [svr]\n")
    house.edit("tiny.yaml", "    crossed: false\n", "    crossed: false\n  tiny: *tiny\n")
    plan = house.snakemake("--summary", "transfer")
    assert plan.returncode == 0, plan.stderr
    planned = [line.split("\t")[0] for line in plan.stdout.splitlines()]
    assert len(planned) == len(set(planned))
    assert {file for file in planned if file.startswith("results/transfer/")} == {
        f"results/transfer/small/mlp/{source}/simulated-twin.csv"
        for source in ["references", *sets]
    }
    assert {file for file in planned if file.startswith("results/models/")} == {
        f"results/models/{trained}/small/mlp/{seed}.pt"
        for trained in ("simulated-twin/place", *(f"{source}/random" for source in sets))
        for seed in (1, 2)
    }
    assert {"results/tables/transfer.csv", "results/tables/transfer.md"} <= set(planned)


def test_a_recording_is_added_by_its_path_alone(house, tmp_path):
    source = house.folder / "results" / "recordings" / "simulated-twin.parquet"
    (tmp_path / "brought.parquet").write_bytes(source.read_bytes())
    (house.folder / "more.yaml").write_text(
        f"recordings: {{brought: {{path: {tmp_path}/brought.parquet}}}}\n"
        "table_1: {recordings: {brought: [place]}}\n"
    )
    plan = house.snakemake("more.yaml", "--summary")
    assert plan.returncode == 0, plan.stderr
    rows = [line.split("\t") for line in plan.stdout.splitlines()]
    pending = {row[0] for row in rows if row[-1] == "update pending"}
    assert "results/recordings/brought.check.txt" in pending
    assert "results/splits/brought/place.parquet" in pending
    assert {file for file in pending if "brought" not in file} == {
        "results/tables/table_1.csv",
        "results/tables/table_1.md",
    }
    made = {"import_recording", "check", "record_dataset", "split", *LEARNING}
    assert house.jobs(files=["more.yaml"]) == made | TABLE


def test_an_importer_s_edit_imports_recordings_of_its_format_alone(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    brought = {"press": logger(house.folder), "frames": parquet(house.folder)}
    named = ", ".join(f"{name}: {{path: {path.name}}}" for name, path in brought.items())
    (house.folder / "more.yaml").write_text(f"recordings: {{{named}}}\n")
    made = [f"results/recordings/{name}.parquet" for name in brought]
    run = house.snakemake("more.yaml", "--", *made)
    assert run.returncode == 0, run.stderr

    def pending(file, addition="UNUSED = 1"):
        path = house.folder / "workflow" / "eitskin" / "data" / file
        path.write_text(f"{path.read_text(encoding='utf-8')}\n{addition}\n")
        plan = house.snakemake("more.yaml", "--summary", "--", *made)
        rows = [line.split("\t") for line in plan.stdout.splitlines()]
        return {row[0] for row in rows if row[-1] == "update pending"}

    assert pending("importers/matrix.py") == set()
    assert pending("boards/circular-16.yaml", "# of a board") == {made[0]}
    assert pending("importers/logger_csv.py") == {made[0]}
    assert pending("importers/__init__.py") == {*made}


def test_the_paper_s_second_table_and_figures_can_be_planned_by_name(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    rules = ["table_2", "figure_1", "figure_2", "figure_3", "figure_4"]
    plan = house.snakemake("--summary", "--", *rules)
    assert plan.returncode == 0, plan.stderr
    planned = {line.split("\t")[0] for line in plan.stdout.splitlines()}
    assert {f"results/tables/table_2.{kind}" for kind in ("csv", "md")} <= planned
    for number in range(1, 5):
        figure = f"results/figures/figure_{number}"
        assert {f"{figure}.{kind}" for kind in ("svg", "png", "csv")} <= planned


def test_the_loop_can_be_planned_by_name_and_is_no_part_of_all(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    plan = house.snakemake("--summary", "loop")
    assert plan.returncode == 0, plan.stderr
    planned = {line.split("\t")[0] for line in plan.stdout.splitlines()}
    case = "results/loop/single-touch-contrast-1"
    sources = ("belief", "authors", "diagnosis", "truth", "labels")
    errors = {f"{case}/errors/mlp/{source}/{seed}.csv" for source in sources for seed in (1, 2)}
    assert errors <= planned
    assert {f"{case}/truth.json", f"{case}/diagnosis/effects.yaml"} <= planned
    assert {f"results/loop/{file}" for file in ("loop.csv", "loop.md", "mlp.svg")} <= planned
    assert not {file for file in planned if file.startswith("results/models/")}
    whole = house.snakemake("--summary")
    assert whole.returncode == 0, whole.stderr
    assert "results/loop/" not in whole.stdout
