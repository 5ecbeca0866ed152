"""A rig in the workflow: `capture` moves the robot, nothing else does, and what it captured is a
recording like any other."""

import json

import pytest
import yaml

from eitskin.capture.attached import manifest_path
from eitskin.capture.plan import plan_sha256
from eitskin.configuration import captured_path

pytestmark = pytest.mark.xdist_group("finished")

DEMO = "workflow/config/demo_capture.yaml"
NAME = "emulated-rig"
REPORT = f"results/diagnosis/{NAME}/report.html"


def jobs(plan):
    """The rules of a dry run."""
    assert plan.returncode == 0, plan.stdout + plan.stderr
    lines = [line.split() for line in (plan.stdout + plan.stderr).splitlines()]
    return {words[0] for words in lines if len(words) == 2 and words[1].isdigit()} - {"total"}


def test_whatever_is_asked_for_only_capture_captures(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    dry = ("--dry-run", "--quiet", "rules", "--forceall", "--")
    planned = jobs(house.snakemake(DEMO, *dry, "all", "loop", "transfer", "table_2", "figure_1"))
    assert {"all", "import_recording", "loop"} <= planned and "capture" not in planned
    assert jobs(house.snakemake(DEMO, *dry, "capture")) == {"capture"}
    refused = house.snakemake(DEMO, *dry, REPORT)
    assert refused.returncode != 0 and "No rule to produce" in refused.stderr + refused.stdout


def test_what_is_captured_is_never_captured_again(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    rig = yaml.safe_load((house.folder / DEMO).read_text(encoding="utf-8"))["rig"]
    place = house.folder / captured_path(NAME)
    place.parent.mkdir(parents=True)
    place.touch()
    said = json.dumps({"plan_sha256": plan_sha256(rig)})
    (house.folder / manifest_path(NAME)).write_text(said, encoding="utf-8")
    for module in ("eitskin/capture/session.py", "scripts/capture.py"):
        with (house.folder / "workflow" / module).open("a", encoding="utf-8") as file:
            file.write("\nUNUSED = 1\n")
    dry = ("--dry-run", "--quiet", "rules", "--forceall", "--")
    plan = house.snakemake(DEMO, *dry, "all", REPORT)
    assert {"check", "diagnose", "record_dataset"} <= jobs(plan)
    assert "capture" not in jobs(plan)
    again = house.snakemake(DEMO, "--forcerun", "capture", "--", "capture")
    assert again.returncode == 0, again.stderr
    assert not (house.folder / "captures").exists()
