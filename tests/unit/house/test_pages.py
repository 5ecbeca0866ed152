"""The pages that people read: their links lead somewhere, the front page is short, the sample that
ships is what its command makes."""

import importlib.util
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from eitskin.data import recording
from eitskin.diagnose import diagnosis
from eitskin.diagnose.verdict import conclusion
from manual.__main__ import PAGES as WRITTEN
from witness.sample import sample

ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINKED = [
    *PAGES,
    *(ROOT / name for name in ("CHANGELOG.md", "CONTRIBUTING.md", "benchmarks/README.md")),
]
MOST_WORDS = 900  # of the front page
SAMPLE = ROOT / "docs" / "sample"
NAMING = [*LINKED, ROOT / "results" / "README.md", ROOT / "config.yaml"]
A_FILE = re.compile(r"`([\w./-]+/[\w-]+\.(?:py|smk|md|rst))`")
A_MODULE = re.compile(r"python -m ([a-z_]\w*(?:\.\w+)*)")
A_TARGET = re.compile(r"(?:^|`)make ([a-z][\w-]*)(?=[` \n])", re.MULTILINE)


@cache
def files() -> list[str]:
    """The paths of all files of the project, each after a slash."""
    folders = ("benchmarks", "docs", "profiles", "tests", "workflow")
    paths = (path for folder in folders for path in (ROOT / folder).rglob("*.*"))
    return [f"/{path.relative_to(ROOT).as_posix()}" for path in paths]


@pytest.mark.parametrize("page", LINKED, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files(page):
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        assert target.startswith("http") or (page.parent / target).exists(), target


@pytest.mark.parametrize("page", LINKED, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_space_stands_before_per_cent(page):
    text = page.read_text(encoding="utf-8")
    assert re.findall(r".*[0-9]%(?![0-9A-F]{2}).*", text) == []


@pytest.mark.parametrize("page", NAMING, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_modules_and_targets_that_are_named_exist(page):
    text = page.read_text(encoding="utf-8")
    for path in A_FILE.findall(text):
        is_known = (ROOT / path).exists() or any(file.endswith(f"/{path}") for file in files())
        assert "NAME" in path or is_known, path
    for module in A_MODULE.findall(text):
        assert importlib.util.find_spec(module) is not None, module
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert set(A_TARGET.findall(text)) <= set(re.findall(r"^([\w-]+):", makefile, re.MULTILINE))


@pytest.mark.parametrize("name", WRITTEN)
def test_pages_from_the_code_are_as_it_is_now(name):
    assert (ROOT / "docs" / name).read_text(encoding="utf-8") == WRITTEN[name]()


def test_the_front_page_is_short():
    read_text = re.sub(r"<!--.*?-->", "", PAGES[0].read_text(encoding="utf-8"))
    assert len(read_text.split()) < MOST_WORDS


def test_the_sample_is_what_its_command_makes():
    case, shipped = sample(), recording.read(SAMPLE / "recording.parquet")
    assert np.allclose(shipped.voltage, case.voltage, rtol=1e-9, atol=1e-15)
    assert shipped.frames["force_N"].to_numpy() == pytest.approx(case.states["force_N"].to_numpy())
    truth = json.loads((SAMPLE / "truth.json").read_text(encoding="utf-8"))
    assert truth["effects"] == case.effects


@pytest.mark.long
def test_the_sample_s_sentence_is_the_one_on_the_front_page():
    found = diagnosis.diagnose(recording.read(SAMPLE / "recording.parquet"))
    (effect,) = conclusion.document(found, "sample")["effects"]
    assert effect["sentence"] in PAGES[0].read_text(encoding="utf-8")


@pytest.mark.long
def test_of_the_sample_without_conductivity_contacts_and_contrast_the_same_is_said():
    shipped = recording.read(SAMPLE / "recording.parquet")
    unknown = ("conductivity_S_per_m", "contact_impedivity_ohm_m2", "contrast_per_N")
    skin = shipped.metadata["skin"] | dict.fromkeys(unknown)
    found = diagnosis.diagnose(replace(shipped, metadata=shipped.metadata | {"skin": skin}))
    said = conclusion.document(found, "sample")
    (effect,) = said["effects"]
    assert (effect["name"], effect["electrodes"]) == ("electrode-position", [6])
    assert effect["parameters"]["shift_deg"]["value"] == pytest.approx(2.0, abs=1e-3)
    assert said["verdict"] == "explained" and not any(
        "at_bound" in c for c in said["calibration"].values()
    )
