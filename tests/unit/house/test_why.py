"""`eitskin why`: what made a product, from what, and what has changed since."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from eitskin import cli, provenance, why
from eitskin.errors import InputError
from eitskin.fingerprint import fingerprint, fingerprinted

CODE = fingerprint("clean", [])


class Files(dict):
    """A job's inputs or outputs by name."""

    def __iter__(self):
        return iter(self.values())


def plan(job, parameters, inputs, product):
    text = provenance.text(job, parameters, CODE, inputs, [product])
    provenance.plan_code(CODE, fingerprinted(CODE))
    planned = provenance.planned_path(job)
    return text, provenance.plan(planned, text, [product], provenance.is_other(planned, text))


def make(job, text, product):
    planned = provenance.planned_path(job)
    snakemake = SimpleNamespace(
        log=[f"logs/{job}.log"],
        input=Files(provenance=planned),
        params=SimpleNamespace(provenance=text, code=CODE),
    )
    with provenance.recorded(snakemake):
        Path(product).parent.mkdir(parents=True, exist_ok=True)
        Path(product).write_text(job)


@pytest.fixture
def finished(tmp_path, monkeypatch):
    """A recording, its dataset and a model of it."""
    monkeypatch.chdir(tmp_path)
    Path("skin.csv").write_text("1")
    digest, texts = provenance.digest_of_file("skin.csv"), []
    for job, parameters, source in (
        ("record", {"frames": None}, "skin.csv"),
        ("train", {"widths": [32]}, "results/record"),
    ):
        text, made = plan(job, parameters, {source: digest}, f"results/{job}")
        assert not made
        make(job, text, f"results/{job}")
        assert plan(job, parameters, {source: digest}, f"results/{job}") == (text, True)
        digest = provenance.digest(text)
        texts.append(text)
    return texts


def test_the_chain_of_a_product_ends_in_what_no_rule_makes(finished):
    steps = why.chain("results/train")
    assert [step["product"] for step in steps] == ["results/train", "results/record", "skin.csv"]
    assert [step.get("rule") for step in steps] == ["train", "record", None]
    assert steps[0]["parameters"] == {"widths": [32]}
    assert not any(step["changed"] for step in steps)


def test_what_has_changed_since_is_told_where_it_did(finished, capsys):
    Path("skin.csv").write_text("2")
    plan("train", {"widths": [64]}, {"results/record": "other"}, "results/train")
    code = Path(provenance.RECORDS, provenance.CODE, f"{CODE}.json")
    modules = json.loads(code.read_text())
    code.write_text(json.dumps(modules | {"eitskin.simulate.sets": "before"}))
    assert cli.main(["why", "results/train"]) == 0
    assert capsys.readouterr().out == (
        "results/train\n"
        "  made by train: widths [32]\n"
        "  changed since: code: eitskin.simulate.sets\n"
        "  changed since: widths: [32], now [64]\n"
        "  results/record\n"
        "    made by record: frames null\n"
        "    changed since: code: eitskin.simulate.sets\n"
        "    skin.csv\n"
        "      changed since: other bytes, or none\n"
    )


def test_a_failed_job_has_no_record(finished):
    with (
        pytest.raises(SystemExit),
        provenance.recorded(
            SimpleNamespace(
                log=["logs/train.log"], input=Files(provenance=provenance.planned_path("train"))
            )
        ),
    ):
        raise InputError("skin.csv", "line 1", "nothing", "a number")
    assert not plan("train", {"widths": [32]}, {}, "results/train")[1]
    with pytest.raises(InputError, match="no record"):
        why.chain("results/train")


def test_a_file_that_no_workflow_made_is_refused(tmp_path):
    (tmp_path / "mine.csv").write_text("1")
    with pytest.raises(InputError, match="beside its records"):
        why.chain(tmp_path / "mine.csv")


def test_bytes_count_whatever_times_say(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a").write_text("one")
    before = provenance.digest_of_file("a")
    Path("b").write_text("two")
    provenance.os.utime("b", (1e9, 1e9))
    Path("b").replace("a")
    assert provenance.digest_of_file("a") != before
    Path("a").write_text("one")
    assert provenance.digest_of_file("a") == before
    assert provenance.digest_of_file("none") == provenance.NO_FILE
