"""The proof through the workflow's own rules: no truth before the verdicts are sealed."""

import base64
import json

import pytest

from concealed import sealing
from eitskin.errors import InputError

pytestmark = pytest.mark.xdist_group("finished")

DEMO = "results/concealed/demo"
OPENED = f"{DEMO}/opened/opened.json"
TRUTHS = "results/truths/"


@pytest.fixture
def house(finished, tmp_path):
    """A finished workflow to edit."""
    return finished.copy(tmp_path / "house")


def plan(house):
    """Inputs by output file, of all that the demo's opening needs; every block's rules are made
    by one loop, and only of files that are there are inputs told."""
    found = house.snakemake("--detailed-summary", "--", OPENED)
    assert found.returncode == 0, found.stderr
    header, *lines = [line.split("\t") for line in found.stdout.splitlines() if line]
    output, given = header.index("output_file"), header.index("input-file(s)")
    return {line[output]: line[given].split(",") for line in lines}


def upstream(inputs, file):
    """Every file from which a path of the plan leads to one."""
    seen, waiting = set(), [file]
    while waiting:
        for given in inputs.get(waiting.pop(), []):
            if given not in seen:
                seen.add(given)
                waiting.append(given)
    return seen


def test_no_path_leads_from_a_truth_to_a_verdict(finished):
    inputs = plan(finished)
    verdicts = [file for file in inputs if "/verdicts/" in file]
    baselines = [file for file in inputs if "/baselines/" in file]
    seal = f"{DEMO}/seal.json"
    assert len(verdicts) == len(baselines) == 2
    for file in [*verdicts, *baselines, seal]:
        assert not [given for given in upstream(inputs, file) if given.startswith(TRUTHS)]
    for file in [*verdicts, *baselines]:
        case = file.removesuffix("/diagnosis.json").removesuffix(".json").split("/")[-1]
        own = {f"{DEMO}/{folder}/{case}.parquet" for folder in ("recordings", "queries")}
        assert own <= set(inputs[file])
        folders = {given.split("/")[-2] for given in inputs[file]}
        assert folders <= {"recordings", "queries", "demo", "schemas"}
    assert upstream(inputs, OPENED) >= {seal, *verdicts, *baselines}
    taken = [file for file, given in inputs.items() if any(g.startswith(TRUTHS) for g in given)]
    assert taken == [OPENED]
    assert f"{TRUTHS}demo/case-001.sealed" in inputs[OPENED]


def test_what_ran_was_given_no_truth(finished):
    records = {}
    for file in (finished.folder / ".snakemake" / "metadata").iterdir():
        name = base64.b64decode(file.name).decode()
        if name.startswith((DEMO, TRUTHS)):
            records[name] = json.loads(file.read_text())
    verdicts = {name: one for name, one in records.items() if "/verdicts/" in name}
    assert len(verdicts) == 2
    secret = ("truth", "sealed", "key.json", "root")
    for name, one in verdicts.items():
        assert one["rule"].startswith("verdicts_demo_")
        assert not [w for w in secret for given in one["input"] + one["params"] if w in given]
        assert {param.strip("'") for param in one["params"]} >= {f"['{name.split('/')[-2]}']", "1"}
        assert len(one["params"]) == 3  # and the fingerprint of the code
    given = {name: one["input"] for name, one in records.items()}
    taken = {name for name, one in given.items() if any(g.startswith(TRUTHS) for g in one)}
    assert taken == {OPENED}


def test_a_demo_is_shown_end_to_end(finished):
    block = finished.folder / DEMO
    record = json.loads((finished.folder / OPENED).read_text())
    assert sealing.check_opened(block) == record["seal"]
    for case in ("case-001", "case-002"):
        said = json.loads((block / "verdicts" / case / "diagnosis.json").read_text())
        truth = json.loads((block / "opened" / f"{case}.json").read_text())
        assert said["recording"] == truth["case"] == case
        assert said["format"] == "eit-diagnosis"
        assert (block / "verdicts" / case / "predicted.parquet").is_file()
    assert not (finished.folder / TRUTHS / "demo" / sealing.ROOT).exists()


def test_a_byte_changed_after_opening_stops_the_workflow(house):
    verdict = f"{DEMO}/verdicts/case-002/diagnosis.json"
    path = house.folder / verdict
    path.write_text(path.read_text().replace('"eit-diagnosis"', '"eit-diagnosed"'))
    run = house.snakemake("--", OPENED)
    assert run.returncode != 0
    assert f"{verdict}: sha256" in run.stdout + run.stderr
    assert (
        "when the truths were opened" in (house.folder / "logs/seal_verdicts/demo.log").read_text()
    )
    with pytest.raises(InputError, match=r"case-002/diagnosis\.json|seal\.json"):
        sealing.check_opened(house.folder / DEMO)


def test_code_of_verdicts_reruns_these_and_draws_nothing_again(house):
    module = house.folder / "workflow" / "concealed" / "verdicts.py"
    module.write_text(f"{module.read_text(encoding='utf-8')}\nUNUSED = 1\n")
    pending = house.pending()
    assert f"{DEMO}/verdicts/case-001/diagnosis.json" in pending and OPENED in pending
    assert not [file for file in pending if "/recordings/case" in file or TRUTHS in file]
