"""What the rules declare: the code that they run, and every file that they write."""

import base64
import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.xdist_group("finished")

LISTED = """
import json
from pathlib import Path
from types import SimpleNamespace
from eitskin import fingerprint

fingerprint.fingerprint = lambda script, *_, **__: script
from snakemake.api import SnakemakeApi
from snakemake.settings.types import ConfigSettings, OutputSettings, Quietness, ResourceSettings

some = SimpleNamespace(configuration="tiny", link="3-crosstalk", model="mlp")
with SnakemakeApi(OutputSettings(quiet={Quietness.ALL})) as api:
    workflow = api.workflow(
        resource_settings=ResourceSettings(cores=1),
        config_settings=ConfigSettings(configfiles=[Path("tiny.yaml")]),
        snakefile=Path("Snakefile"),
    )
    found = {}
    for rule in workflow._workflow.rules:
        code = dict(rule.params.items()).get("code")
        found[rule.name] = rule.script, code(some) if callable(code) else code
print(json.dumps(found))
"""
ON_REQUEST = {"trials", "capture"}  # hours of work, and a robot: no code plans them again


@pytest.fixture(scope="module")
def rules(fresh):
    """Script and code of every rule by its name."""
    done = subprocess.run(
        [sys.executable, "-c", LISTED],
        cwd=fresh.folder,
        env=fresh.environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_every_rule_goes_by_the_code_of_its_own_script(rules):
    assert len(rules) > 40
    for name, (script, code) in rules.items():
        if script is None or name in ON_REQUEST:
            assert code is None, name
        else:
            assert code == Path(script).stem, name


def test_every_script_belongs_to_a_rule(rules, fresh):
    used = {Path(script).name for script, _ in rules.values() if script}
    scripts = {path.name for path in (fresh.folder / "workflow" / "scripts").glob("*.py")}
    assert scripts - used == {"capture.py"}  # its rule is there where a rig is


def test_parsing_makes_the_rules_of_the_blocks_in_use_alone(rules):
    blocks = {name.split("_")[1] for name in rules if name.startswith("verdicts_")}
    assert blocks == {"demo", "gate"}


def test_every_file_that_is_written_is_declared(finished):
    records = finished.folder / ".snakemake" / "metadata"
    declared = {base64.b64decode(file.name).decode() for file in records.iterdir()}
    for file in (finished.folder / "results").rglob("*"):
        path = file.relative_to(finished.folder)
        if file.is_file() and file.name != ".snakemake_timestamp":
            assert {str(path), *map(str, path.parents)} & declared, f"no rule declares {path}"
