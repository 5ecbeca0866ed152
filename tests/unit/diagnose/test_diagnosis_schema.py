"""diagnosis.json against its schema, and against what a schema cannot say."""

import copy
import json

import pytest
import yaml

from diagnosed_skin import KINDS, SCHEMA, diagnosed
from eitskin.diagnose.validation import validate
from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from eitskin.schema import Validator

RULES = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))
BY_SCHEMA = Validator(RULES)
NAMES = RULES["$defs"]["name"]["enum"]
UNITS = {
    name: rule["properties"]["unit"]["const"]
    for name, rule in RULES["$defs"].items()
    if "unit" in rule.get("properties", {}) and "$ref" in rule
}


@pytest.fixture(scope="module")
def valid(tmp_path_factory):
    """diagnosis.json of each kind."""
    folder = tmp_path_factory.mktemp("diagnoses")
    found = {}
    for kind in KINDS:
        diagnosed(folder / kind, kind)
        found[kind] = json.loads((folder / kind / "diagnosis.json").read_text(encoding="utf-8"))
    return found


def refused(diagnosis, match):
    with pytest.raises(InputError, match=match):
        validate(diagnosis, SCHEMA, "diagnosis.json")


def changed(diagnosis, path, value):
    """A copy with the value at a path of keys and indices replaced."""
    result = copy.deepcopy(diagnosis)
    node = result
    for part in path[:-1]:
        node = node[part]
    node[path[-1]] = value
    return result


def test_every_kind_is_valid(valid):
    for diagnosis in valid.values():
        validate(diagnosis, SCHEMA, "diagnosis.json")


def test_names_drivers_units_and_sites_are_the_catalogue_s():
    """A composite is told by what it is made of."""
    assert {name for name, effect in EFFECTS.items() if not effect.composite} <= set(NAMES)
    for name in set(EFFECTS) & set(NAMES):
        effect, rule = EFFECTS[name], RULES["$defs"][name]
        where, driver = (part["$ref"].rpartition("/")[2] for part in rule["allOf"])
        assert driver == effect.driver, name
        sites = {"at-electrodes": "electrodes", "at-two-electrodes": "electrodes", "whole": None}
        sites |= {f"at-{kind}": kind for kind in ("drives", "measures", "channels")}
        assert sites[where] == next(iter(effect.sites), None), name
        parameters = rule["properties"]["parameters"]["properties"]
        units = {key: UNITS[one["$ref"].rpartition("/")[2]] for key, one in parameters.items()}
        assert units == {key: one.unit for key, one in effect.parameters.items()}, name
        needed = rule["properties"]["parameters"]["required"]
        assert set(needed) == {k for k, one in effect.parameters.items() if not one.optional}


def test_every_name_has_its_rule():
    rules = RULES["$defs"]["effect"]["allOf"]
    asked = [rule["if"]["properties"]["name"]["const"] for rule in rules]
    assert sorted(asked) == sorted(NAMES)
    for name, rule in zip(asked, rules, strict=True):
        assert rule["then"]["$ref"] == f"#/$defs/{name}"


def keys(node, path=()):
    """Paths of every key of nested mappings and lists, but those that a user names."""
    for key, value in node.items():
        yield (*path, key)
        items = enumerate(value) if isinstance(value, list) else [(None, value)]
        for index, item in items:
            if isinstance(item, dict) and key != "calibration":
                yield from keys(item, (*path, key) if index is None else (*path, key, index))


def test_every_key_is_needed_and_no_other_is_known(valid):
    paths = list(keys(valid["explained"]))
    assert len(paths) > 40
    for path in paths:
        missing = copy.deepcopy(valid["explained"])
        node = missing
        for part in path[:-1]:
            node = node[part]
        del node[path[-1]]
        assert not BY_SCHEMA.is_valid(missing), path

        extra = copy.deepcopy(valid["explained"])
        node = extra
        for part in path[:-1]:
            node = node[part]
        node["extra"] = 1
        assert not BY_SCHEMA.is_valid(extra), path
    refused(valid["explained"] | {"extra": 1}, "extra: found an unknown key")


EFFECT = ("effects", 0)
RATIO = (*EFFECT, "parameters", "ratio")


@pytest.mark.parametrize(
    ("path", "value", "match"),
    [
        (("format",), "eit-recording", "format"),
        (("version",), 2, "version"),
        (("verdict",), "perhaps", "verdict: found 'perhaps', expected one of consistent"),
        (("noise_V",), 0.0, "noise_V: found 0.0, expected more than 0"),
        (("noise_V",), float("nan"), "noise_V"),
        (("unobservable",), ["ofset"], "unobservable"),
        (
            (*EFFECT, "name"),
            "contact-resistance",
            r"effects\[0\]\.name: found 'contact-r",
        ),
        ((*EFFECT, "name"), "ellipse", "name"),
        ((*EFFECT, "name"), "electrode-width", "ratio: found an unknown key|width_mm"),
        ((*EFFECT, "alternatives"), ["width"], "alternatives"),
        ((*EFFECT, "alternatives"), ["contact-impedance"], "names other than its own"),
        ((*EFFECT, "driver"), "time", "driver: found 'time', expected static"),
        ((*EFFECT, "scope"), "everywhere", "scope"),
        ((*EFFECT, "scope"), "common", "electrodes"),
        ((*EFFECT, "electrodes"), [], "electrodes"),
        ((*EFFECT, "electrodes"), [-1], "electrodes"),
        ((*EFFECT, "electrodes"), [7, 7], "electrodes"),
        ((*EFFECT, "drives"), [7], "drives"),
        ((*EFFECT, "channels"), [7], "channels"),
        ((*RATIO, "unit"), "%", "unit: found '%', expected the unit 1"),
        ((*RATIO, "value"), "2.1", "value"),
        ((*RATIO, "low"), 2.2, "low ≤ value ≤ high"),
        ((*RATIO, "high"), [2.2], "low, value and high of one shape"),
        ((*EFFECT, "evidence", "p_value"), 1.5, "p_value"),
        ((*EFFECT, "evidence", "elpd_se"), -1, "elpd_se"),
        ((*EFFECT, "gap"), -0.1, "gap"),
        ((*EFFECT, "sentence"), "", "sentence"),
        (("other", "probability"), 1.1, "probability"),
        (("other", "probability"), 0.5, "probability|sentence"),
        (("other", "driver"), "weather", "driver"),
        (("fit", "held_out", "frames"), 0, "frames"),
        (("calibration", "conductivity_S_per_m", "unit"), 1, "unit"),
    ],
)
def test_what_is_wrong_is_named(valid, path, value, match):
    refused(changed(valid["explained"], path, value), match)


def test_a_gap_may_be_missing_and_an_effect_everywhere(valid):
    without = changed(valid["explained"], (*EFFECT, "gap"), None)
    everywhere = changed(without, (*EFFECT, "scope"), "common")
    everywhere["effects"][0]["electrodes"] = []
    validate(without, SCHEMA, "diagnosis.json")
    validate(everywhere, SCHEMA, "diagnosis.json")


@pytest.mark.parametrize(
    ("verdict", "kind"),
    [
        ("consistent", "explained"),
        ("unexplained", "explained"),
        ("explained", "consistent"),
        ("partly-explained", "consistent"),
        ("unexplained", "consistent"),
        ("consistent", "unexplained"),
        ("explained", "partly-explained"),
    ],
)
def test_a_verdict_must_follow_from_the_rest(valid, verdict, kind):
    refused(valid[kind] | {"verdict": verdict}, "effects|other")


def test_lists_run_parallel_to_the_sites(valid):
    dense = changed(valid["explained"], (*EFFECT, "scope"), "dense")
    dense["effects"][0]["electrodes"] = [3, 4, 7]
    ratio = {"value": [1.0, 1.5, 2.0], "low": [0.9, 1.4, 1.9], "high": [1.1, 1.6, 2.1], "unit": "1"}
    dense["effects"][0]["parameters"]["ratio"] = ratio
    validate(dense, SCHEMA, "diagnosis.json")
    dense["effects"][0]["electrodes"] = [3, 4]
    refused(dense, r"3 values, expected one a site \(2\)")


def test_what_has_no_name_is_described(valid):
    refused(changed(valid["unexplained"], ("other", "sentence"), None), "sentence")


def test_two_wires_are_exchanged(valid):
    swap = changed(valid["explained"], (*EFFECT, "name"), "electrode-swap")
    swap["effects"][0]["parameters"] = {}
    refused(swap, "electrodes")
    swap["effects"][0]["electrodes"] = [3, 7]
    validate(swap, SCHEMA, "diagnosis.json")


@pytest.mark.parametrize("keys", [[], ["cubic", "limit_V"]])
def test_a_converter_has_one_law(valid, keys):
    unit = {"cubic": "1/V²", "limit_V": "V"}
    adc = changed(valid["explained"], (*EFFECT, "name"), "adc-nonlinearity")
    effect = adc["effects"][0] | {"scope": "common", "electrodes": [], "driver": "amplitude"}
    estimate = {"value": 1.0, "low": 0.9, "high": 1.1}
    effect["parameters"] = {key: estimate | {"unit": unit[key]} for key in ["cubic"]}
    adc["effects"] = [effect]
    validate(adc, SCHEMA, "diagnosis.json")
    effect["parameters"] = {key: estimate | {"unit": unit[key]} for key in keys}
    refused(adc, "parameters: found .* expected (1 or more keys|cubic or limit_V)")
