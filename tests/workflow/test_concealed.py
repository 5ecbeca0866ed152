"""The proof through the workflow's own rules: no truth before the verdicts are sealed."""

import base64
import json

import pytest

from eitskin.errors import InputError
from proof import sealing

pytestmark = pytest.mark.xdist_group("finished")

DEMO = "results/concealed/demo"
OPENED = f"{DEMO}/opened"
TRUTHS = "results/truths/"
CASES = ("case-001", "case-002")


@pytest.fixture
def house(finished, tmp_path):
    """A finished workflow to edit."""
    return finished.copy(tmp_path / "house")


@pytest.fixture(scope="module")
def inputs(finished):
    """Inputs by output file, of every job of the demo that ran, as Snakemake has recorded them."""
    return {name: one["input"] for name, one in records(finished).items()}


def records(house):
    """Snakemake's record of each of the demo's files."""
    found = {}
    for file in (house.folder / ".snakemake" / "metadata").iterdir():
        name = base64.b64decode(file.name).decode()
        if name.startswith((DEMO, TRUTHS)):
            found[name] = json.loads(file.read_text())
    return found


def upstream(inputs, file):
    """Every file from which a path of the plan leads to one."""
    seen, waiting = set(), [file]
    while waiting:
        for given in inputs.get(waiting.pop(), []):
            if given not in seen:
                seen.add(given)
                waiting.append(given)
    return seen


def test_no_path_leads_from_a_truth_to_a_verdict(inputs):
    verdicts = [f"{DEMO}/verdicts/{case}" for case in CASES]
    baselines = [f"{DEMO}/baselines/{case}.{end}" for case in CASES for end in ("json", "npz")]
    seal = f"{DEMO}/seal.json"
    assert inputs.keys() >= {*verdicts, *baselines, seal, OPENED}
    for file in [*verdicts, *baselines, seal]:
        assert not [given for given in upstream(inputs, file) if given.startswith(TRUTHS)]
    for file in [*verdicts, *baselines]:
        case = file.split("/")[-1].partition(".")[0]
        own = {f"{DEMO}/{folder}/{case}.parquet" for folder in ("recordings", "queries")}
        assert own <= set(inputs[file])
        folders = {given.split("/")[-2] for given in inputs[file]}
        assert folders <= {"recordings", "queries", "demo", "diagnose"}
    assert upstream(inputs, OPENED) >= {seal, *verdicts, *baselines}
    taken = [file for file, given in inputs.items() if any(g.startswith(TRUTHS) for g in given)]
    assert taken == [OPENED]
    assert f"{TRUTHS}demo/case-001.sealed" in inputs[OPENED]


def test_what_ran_was_given_no_truth(finished):
    verdicts = {name: one for name, one in records(finished).items() if "/verdicts/" in name}
    assert verdicts.keys() == {f"{DEMO}/verdicts/{case}" for case in CASES}
    secret = ("truth", "sealed", "key.json", "root")
    for name, one in verdicts.items():
        assert one["rule"].startswith("verdicts_demo_")
        assert not [w for w in secret for given in one["input"] + one["params"] if w in given]
        assert {param.strip("'") for param in one["params"]} >= {f"['{name.split('/')[-1]}']", "1"}
        assert len(one["params"]) == 3  # and the fingerprint of the code


def test_a_demo_is_shown_end_to_end(finished):
    block = finished.folder / DEMO
    record = json.loads((finished.folder / OPENED / "opened.json").read_text())
    assert sealing.check_opened(block) == record["seal"]
    for case in ("case-001", "case-002"):
        said = json.loads((block / "verdicts" / case / "diagnosis.json").read_text())
        truth = json.loads((block / "opened" / f"{case}.json").read_text())
        assert said["recording"] == truth["case"] == case
        assert said["format"] == "eit-diagnosis"
        assert (block / "verdicts" / case / "predicted.parquet").is_file()
    assert not (finished.folder / TRUTHS / "demo" / sealing.ROOT).exists()


def test_a_byte_changed_after_opening_stops_the_score(house):
    verdict = f"{DEMO}/verdicts/case-002/diagnosis.json"
    path = house.folder / verdict
    path.write_text(path.read_text().replace('"eit-diagnosis"', '"eit-diagnosed"'))
    run = house.snakemake("--forcerun", "concealed_score", "--", "concealed_demo")
    assert run.returncode != 0
    assert f"{verdict}: sha256" in run.stdout + run.stderr
    with pytest.raises(InputError, match=r"case-002/diagnosis\.json|seal\.json"):
        sealing.check_opened(house.folder / DEMO)


def test_a_sealed_block_is_never_planned_again(house):
    for module in ("verdicts", "conceal", "sealing", "baselines", "oracle"):
        path = house.folder / "workflow" / "proof" / f"{module}.py"
        path.write_text(f"{path.read_text(encoding='utf-8')}\nUNUSED = 1\n")
    assert house.jobs("concealed_demo", files=["--forceall"]) == {
        "concealed_score",
        "concealed_figures",
        "concealed_case",
        "concealed_demo",
    }
    plan = house.snakemake("--dry-run")
    told = plan.stdout + plan.stderr
    assert "The concealed cases demo are sealed and stay as they are; changed since: " in told
    assert "proof.conceal" in told and "rm -r results/concealed/demo results/truths/demo" in told


def test_code_of_verdicts_reruns_these_before_the_seal_and_draws_nothing_again(house):
    (house.folder / DEMO / "seal.json").unlink()
    (house.folder / OPENED / "opened.json").unlink()
    path = house.folder / "workflow" / "proof" / "verdicts.py"
    path.write_text(f"{path.read_text(encoding='utf-8')}\nUNUSED = 1\n")
    planned = house.jobs("concealed_demo")
    assert {"verdicts_demo_0", "verdicts_demo_1", "seal_verdicts", "open_truths"} <= planned
    assert not {rule for rule in planned if rule.startswith(("conceal_", "commit"))}
