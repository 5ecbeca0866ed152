"""What the rules declare: the code that they run, and every file that they write."""

import base64
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from house import ROOT

from eitskin import provenance
from eitskin.data import importers
from eitskin.effects import catalogue_names, modules

pytestmark = pytest.mark.xdist_group("finished")

LISTED = """
import json
from pathlib import Path
from types import SimpleNamespace
from eitskin import fingerprint

fingerprint.fingerprint = lambda script, found=None, files=(): (script, found, list(files))
from snakemake.api import SnakemakeApi
from snakemake.settings.types import ConfigSettings, OutputSettings, Quietness, ResourceSettings

named = {"configuration": "tiny", "link": "3-crosstalk", "model": "mlp"}
some = SimpleNamespace(**named, recording="simulated-twin")
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
SCHEMA = "workflow/eitskin/diagnose/diagnosis.schema.yaml"
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
            assert code[0] == Path(script).stem, name


def test_what_code_finds_by_name_and_what_it_reads_is_told(rules):
    told = {name: (set(code[1] or ()), code[2]) for name, (_, code) in rules.items() if code}
    catalogue = set(modules(catalogue_names()))
    ellipse = {"eitskin.effects.ellipse"}
    learned = {"eitskin.learn.networks.mlp"}
    formats = set(importers.modules())
    assert told["import_recording"][0] == set()  # of the twin, which is in our own format
    assert told["perturb"][0] == {"eitskin.effects.crosstalk"}
    assert told["skin_effects"][0] == ellipse | {"eitskin.effects.electrode_position"}
    assert told["twin"][0] == {"eitskin.effects.contact_impedance"}
    for name in ("diagnose", "diagnose_with_query", "diagnose_loop", "diagnosis_report"):
        assert told[name] == (catalogue, [SCHEMA])
    for name in ("train_predictor", "evaluate", "predict", "transfer_source", "ablation_tuned"):
        assert told[name][0] == learned
    for name in ("conceal_demo_0", "oracle_demo_0"):
        assert told[name][0] == catalogue | formats
    for name in ("concealed_score", "concealed_case"):
        assert told[name][0] == catalogue  # and no format: an importer's edit leaves them
    assert told["verdicts_demo_0"] == (catalogue, [SCHEMA])
    assert told["loop_errors"][0] == catalogue | ellipse | learned
    assert ellipse < told["table_2"][0] and len(told["table_2"][1]) == 1
    assert len(told["table_1"][1]) == 1 and not told["figure_2"][1]


def test_every_script_belongs_to_a_rule(rules, fresh):
    used = {Path(script).name for script, _ in rules.values() if script}
    scripts = {path.name for path in (fresh.folder / "workflow" / "scripts").glob("*.py")}
    assert scripts - used == {"capture.py"}  # its rule is there where a rig is


def test_parsing_makes_the_rules_of_the_blocks_in_use_alone(rules):
    blocks = {name.split("_")[1] for name in rules if name.startswith("verdicts_")}
    assert blocks == {"demo", "gate"}


def test_wildcards_are_constrained_for_all_rules_in_one_statement():
    """With results in a storage a second one undoes those of the rules before it."""
    files = [ROOT / "Snakefile", *sorted((ROOT / "workflow" / "rules").glob("*.smk"))]
    stated = {
        file.name: file.read_text(encoding="utf-8").count("\nwildcard_constraints:")
        for file in files
    }
    assert {name: count for name, count in stated.items() if count} == {"configuration.smk": 1}


def test_every_file_that_is_written_is_declared(finished):
    records = finished.folder / ".snakemake" / "metadata"
    declared = {base64.b64decode(file.name).decode() for file in records.iterdir()}
    for file in (finished.folder / "results").rglob("*"):
        path = file.relative_to(finished.folder)
        recorded = path.is_relative_to(provenance.RECORDS)
        if file.is_file() and file.name != ".snakemake_timestamp" and not recorded:
            assert {str(path), *map(str, path.parents)} & declared, f"no rule declares {path}"


def test_every_rule_says_what_it_makes_also_where_catalogues_look(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    listed = house.forked("--snakefile", "workflow/Snakefile", "--list-rules")
    rules = [line for line in listed.stdout.splitlines() if line]
    assert listed.returncode == 0 and len(rules) > 60, listed.stderr
    assert not [rule for rule in rules if not re.fullmatch(r"\w+ \(.+\.\)", rule)]
    assert listed.stdout == house.forked("--list-rules").stdout
