"""A release is called the same everywhere: by the package, the changelog and the citation."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[3]
HEADINGS = re.findall(
    r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
)


def test_package_changelog_and_citation_have_one_version_and_date():
    package = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    newest = f"{package['version']} ({citation['date-released']})"
    assert HEADINGS[1] == newest and citation["version"] == package["version"]


def test_what_is_not_released_comes_first_and_each_release_has_its_date():
    assert HEADINGS[0] == "Unreleased"
    dates = [re.fullmatch(r"\d+\.\d+\.\d+ \((\d{4}-\d\d-\d\d)\)", h)[1] for h in HEADINGS[1:]]
    assert dates == sorted(dates, reverse=True)
