"""diagnosis.json against its schema, and against what a schema cannot say."""

import copy
import json

import pytest
import yaml

from diagnosed_skin import KINDS, RIG, SCHEMA, diagnosed, with_rig
from eitskin.diagnose.verdict.validation import schema, validate
from eitskin.effects import EFFECTS, catalogue_names
from eitskin.effects.effect import SITES
from eitskin.errors import InputError
from eitskin.schema import Validator

RULES = schema(SCHEMA)
BY_SCHEMA = Validator(RULES)


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


def entry(valid, name):
    """An entry of an effect as little as it may say: everywhere, or at its sites."""
    effect, (made,) = EFFECTS[name], copy.deepcopy(valid["explained"]["effects"])
    estimate = {"value": 1.0, "low": 0.9, "high": 1.1}
    kind = next(iter(effect.sites), None)
    needed = {key: one for key, one in effect.parameters.items() if not one.optional}
    needed |= {key: effect.parameters[key] for key in effect.either[:1]}
    return {
        **made,
        "name": name,
        "alternatives": [],
        "scope": "sparse" if kind else "common",
        **{each: [1, 2][: effect.site_number or 1] if each == kind else [] for each in SITES},
        "driver": effect.driver,
        "parameters": {key: {**estimate, "unit": one.unit} for key, one in needed.items()},
    }


@pytest.mark.parametrize("name", catalogue_names())
def test_an_effect_s_sites_driver_parameters_and_units_are_its_own(valid, name):
    effect, made = EFFECTS[name], entry(valid, name)

    def accepted(**changes):
        return BY_SCHEMA.is_valid({**valid["explained"], "effects": [{**made, **changes}]})

    assert accepted()
    assert not accepted(driver="static" if effect.driver != "static" else "force")
    by_channel = {"drives", "measures", "channels"} & {*effect.sites}
    for kind in SITES:
        own = kind in effect.sites or (kind == "channels" and by_channel)
        assert accepted(**{kind: made[kind] or [1]}) == bool(own), kind
    everywhere = {kind: [] for kind in SITES}
    assert accepted(scope="common", **everywhere) == (effect.site_number is None)
    assert accepted(**everywhere) == (not effect.sites)
    for key, estimate in made["parameters"].items():
        rest = {other: one for other, one in made["parameters"].items() if other != key}
        assert not accepted(parameters=rest), key
        assert not accepted(parameters={**rest, key: {**estimate, "unit": "?"}}), key
    unknown = {"value": 1.0, "low": 0.9, "high": 1.1, "unit": "1"}
    assert not accepted(parameters={**made["parameters"], "other": unknown})


def test_the_names_are_the_catalogue_s():
    """A composite is told by what it is made of."""
    written = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))["$defs"]["name"]
    assert "enum" not in written and RULES["$defs"]["name"]["enum"] == catalogue_names()
    assert {name for name, effect in EFFECTS.items() if effect.composite} == {"ellipse"}
    assert "ellipse" not in catalogue_names()


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
        assert BY_SCHEMA.is_valid(missing) == (path == ("fit", "last")), path

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


@pytest.fixture(scope="module")
def additional(tmp_path_factory):
    """diagnosis.json with all that it may hold besides."""
    folder = tmp_path_factory.mktemp("rig")
    diagnosed(folder, "partly-explained")
    with_rig(folder)
    return json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))


def test_the_rig_may_be_told(additional):
    validate(additional, SCHEMA, "diagnosis.json")
    least = additional | {"noise": {"components": []}}
    validate(least, SCHEMA, "diagnosis.json")
    at = ("noise", "components", 0)
    correlation = dict(RIG["components"][0], name="correlated-noise", unit="1")
    validate(changed(additional, at, correlation | {"low": -0.1}), SCHEMA, "diagnosis.json")
    validate(changed(additional, (*at, "name"), "a-tool-s-own"), SCHEMA, "diagnosis.json")
    for key in RIG["components"][0]:
        missing = copy.deepcopy(additional)
        del missing["noise"]["components"][0][key]
        refused(missing, rf"noise\.components\[0\]\.{key}: found no such key")
    refused(changed(additional, at, correlation | {"high": 1.1}), "high: found 1.1, expected 1 or")


PLACES = ("noise", "components", 0)


@pytest.mark.parametrize(
    ("path", "value", "match"),
    [
        (("noise", "extra"), 1, "noise.extra: found an unknown key"),
        (("noise", "loud_frames"), [-1], "loud_frames"),
        (("noise", "jumps"), [1.5], "jumps"),
        (("noise", "unlabelled"), [[3]], r"noise\.unlabelled\[0\]: found"),
        (("noise", "unlabelled"), [[-3, 4]], r"noise\.unlabelled\[0\]\[0\]: found -3"),
        (("noise", "spikes", "share"), 1.5, "share"),
        ((*PLACES, "extra"), 1, "extra: found an unknown key"),
        ((*PLACES, "name"), "Place", "name"),
        ((*PLACES, "unit"), "", "unit"),
        ((*PLACES, "low"), -0.1, "low: found -0.1, expected 0 or more"),
        ((*PLACES, "low"), 0.45, r"noise\.components\[0\]: found sd 0\.41, .* low ≤ sd ≤ high"),
        ((*PLACES, "high"), 0.40, "low ≤ sd ≤ high"),
        ((*PLACES, "sd"), [0.41], "sd: found .* expected a finite number"),
        ((*PLACES, "learned"), 1, "learned: found 1, expected true or false"),
        ((*EFFECT, "certain"), "no", "certain: found 'no', expected true or false"),
        (("fit", "held_out", "white_chi2_per_dof_after"), -1.0, "white_chi2_per_dof_after"),
    ],
)
def test_what_is_wrong_of_the_rig_is_named(additional, path, value, match):
    refused(changed(additional, path, value), match)


def test_what_explains_is_certain(valid):
    validate(changed(valid["explained"], (*EFFECT, "certain"), True), SCHEMA, "diagnosis.json")
    refused(changed(valid["explained"], (*EFFECT, "certain"), False), "certain: found False")


def test_white_chi2_is_told_before_and_after(additional):
    del additional["fit"]["held_out"]["white_chi2_per_dof_before"]
    refused(additional, "fit.held_out")


def test_the_own_sizes_before_are_told_of_the_last_set_alone(valid):
    assert "chi2_per_dof_before_own_sizes" in valid["explained"]["fit"]["last"]
    at = ("fit", "held_out", "chi2_per_dof_before_own_sizes")
    refused(changed(valid["explained"], at, 1.0), "fit.held_out")


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


def test_what_parameters_come_to(valid):
    amount = {"value": 0.4, "low": 0.3, "high": 0.5, "unit": "mm"}
    patch = {**entry(valid, "conductivity-patch"), "amounts": {"equivalent_radius_mm": amount}}
    made = changed(valid["explained"], ("effects",), [patch])
    validate(made, SCHEMA, "diagnosis.json")
    at = ("effects", 0, "amounts", "equivalent_radius_mm", "high")
    refused(changed(made, at, 0.35), r"amounts\.equivalent_radius_mm: found value 0\.4")
    other = {**entry(valid, "crosstalk"), "amounts": patch["amounts"]}
    refused(changed(made, ("effects",), [other]), r"effects\[0\]\.amounts")
