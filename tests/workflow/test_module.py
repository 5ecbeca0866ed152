"""The workflow as a module of another one, in a folder of its own."""

import shutil
import subprocess
import sys

import pytest

SNAKEFILE = """
configfile: "mine.yaml"

module eitskin:
    snakefile: "{snakefile}"
    config: config["eitskin"]

use rule * from eitskin as eitskin_*

rule all:
    default_target: True
    input:
        rules.eitskin_table_1.output.markdown,
        "results/diagnosis/simulated-twin/report.html",
    output: "answer.txt"
    shell: "cat {{input[0]}} > {{output}}"
"""
CONFIG = """
eitskin:
  forces: {levels: 8}
  budgets: {first: {seeds: 2}}
mine: 3
"""


@pytest.fixture
def run(fresh, tmp_path):
    """Run Snakemake in a folder that holds another workflow alone."""
    (tmp_path / "Snakefile").write_text(SNAKEFILE.format(snakefile=fresh.folder / "Snakefile"))
    (tmp_path / "mine.yaml").write_text(CONFIG)

    def snakemake(*arguments):
        return subprocess.run(
            [sys.executable, "-m", "snakemake", "--cores", "1", *arguments],
            cwd=tmp_path,
            env=fresh.environment,
            capture_output=True,
            text=True,
        )

    return snakemake


def test_another_workflow_plans_what_it_needs_of_this_one(run, tmp_path):
    (tmp_path / "config.yaml").write_text("__use_yte__: true\nrecordings: {theirs: 1}\n")
    plan = run("--dry-run")
    assert plan.returncode == 0, plan.stdout + plan.stderr
    said = plan.stdout + plan.stderr
    jobs = {w[0]: int(w[1]) for w in map(str.split, said.splitlines()) if w[1:] and w[1].isdigit()}
    assert jobs["all"] == jobs["eitskin_table_1"] == jobs["eitskin_diagnosis_report"] == 1
    assert (
        jobs["eitskin_train_predictor"] == 2 * 3
    )  # seeds of its own configuration, models of ours
    assert "results/tables/table_1.md" in said and not (tmp_path / "results").exists()


def test_what_is_wrong_in_its_configuration_is_refused(run, tmp_path):
    (tmp_path / "mine.yaml").write_text(CONFIG.replace("levels", "level"))
    plan = run("--dry-run")
    assert plan.returncode != 0
    said = plan.stdout + plan.stderr
    assert "config of the module: forces.level: found an unknown key" in said


def test_without_the_package_it_says_what_to_install(run, fresh, tmp_path):
    shutil.copytree(fresh.folder / "workflow" / "rules", tmp_path / "alone" / "workflow" / "rules")
    shutil.copy(fresh.folder / "Snakefile", tmp_path / "alone")
    absent = "import sys; sys.modules['eitskin'] = None; from snakemake.cli import main; main()"
    plan = subprocess.run(
        [sys.executable, "-c", absent, "--snakefile", "alone/Snakefile", "--dry-run"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert plan.returncode != 0
    assert "eitskin is not in Snakemake's Python: pip install" in plan.stdout + plan.stderr
    assert "Traceback" not in plan.stderr
