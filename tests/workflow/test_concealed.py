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
BLOCKS = ("demo", "development", "gate", "final")


@pytest.fixture
def house(finished, tmp_path):
    """A finished workflow to edit."""
    return finished.copy(tmp_path / "house")


def plan(house, block):
    """Inputs by output file, of all that a block's opening needs."""
    target = f"results/concealed/{block}/opened/opened.json"
    found = house.snakemake("--detailed-summary", "--", target)
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


@pytest.mark.parametrize("block", BLOCKS)
def test_no_path_leads_from_a_truth_to_a_verdict(finished, block):
    inputs = plan(finished, block)
    verdicts = [file for file in inputs if "/verdicts/" in file]
    seal = f"results/concealed/{block}/seal.json"
    opened = f"results/concealed/{block}/opened/opened.json"
    size = {"demo": 2, "development": 60, "gate": 24, "final": 300}[block]
    assert len(verdicts) == size
    for file in [*verdicts, seal]:
        assert not [given for given in upstream(inputs, file) if given.startswith(TRUTHS)]
    for verdict in verdicts:
        case = verdict.split("/")[-2]
        own = {f"results/concealed/{block}/{d}/{case}.parquet" for d in ("recordings", "queries")}
        assert own <= set(inputs[verdict])
        folders = {given.split("/")[-2] for given in inputs[verdict]}
        assert folders <= {"recordings", "queries", block, "schemas"}
    assert upstream(inputs, opened) >= {seal, *verdicts}
    taken = [file for file, given in inputs.items() if any(g.startswith(TRUTHS) for g in given)]
    assert taken == [opened]
    assert f"{TRUTHS}{block}/case-001.sealed" in inputs[opened]


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
