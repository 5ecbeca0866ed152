"""Edits of notation, values and code make again what depends on them, and the page says so.

All are planned by forks of one process on one copy of the finished run (`House.after`).
"""

import json

import edits
import pytest
from edits import EDITS, PAGE, dependents, named, replacements

from eitskin import provenance

pytestmark = pytest.mark.xdist_group("finished")

ALL = [*EDITS["code"], *EDITS["values"]]
OF_THE_PAGE = [edit for edit in ALL if "row" in edit]
OTHERS = [edit for edit in ALL if "row" not in edit]


@pytest.fixture(scope="module")
def house(finished, tmp_path_factory):
    return finished.copy(tmp_path_factory.mktemp("edits") / "house")


@pytest.fixture(scope="module")
def made(house):
    """Rule and inputs of every product by its path."""
    records = {
        product: json.loads(record.read_text(encoding="utf-8"))
        for product, record in provenance.records(house.folder).items()
    }
    rules = {product: content["rule"] for product, content in records.items()}
    return rules, {product: {*content["inputs"]} for product, content in records.items()}


def test_equal_values_in_other_notations_make_nothing_again(house):
    (plan,) = house.after([[tuple(edit) for edit in EDITS["notation"]]])
    assert {file for file, stale in plan.items() if stale} == set()


@pytest.mark.parametrize(
    "some", [OF_THE_PAGE, pytest.param(OTHERS, marks=pytest.mark.long)], ids=["page", "others"]
)
def test_an_edit_makes_again_what_depends_on_it(house, made, some):
    rules, inputs = made
    wrong = {}
    for edit, plan in zip(some, house.after([replacements(edit) for edit in some]), strict=True):
        expected = dependents(edit, plan, rules, inputs)
        planned = {file for file, stale in plan.items() if stale}
        if planned != expected:
            wrong[str(edit["edit"])] = sorted(planned - expected), sorted(expected - planned)
        if "again" in edit:
            beside = {file.rpartition("/")[0]: rule for file, rule in rules.items()}
            again = {rules.get(file) or beside[file.rpartition("/")[0]] for file in expected}
            if again != {*named(edit["again"])}:
                wrong[f"row {edit['row'][0]}"] = sorted(again)
    assert wrong == {}


def test_the_table_on_the_page_is_of_these_edits():
    text = PAGE.read_text(encoding="utf-8")
    assert edits.page(text) == text, "run python tests/workflow/edits.py"
    tests = (edits.HERE / "test_plans.py").read_text(encoding="utf-8")
    assert all(f"def {edit['test']}(" in tests for edit in EDITS["besides"])
