"""The configuration is refused in one line that names file, place, found and expected."""

import copy
import functools
import json
import re
from pathlib import Path

import jsonschema
import pytest
import yaml

from eitskin.configuration import any_of, canonical, schema, validate
from eitskin.data import importers
from eitskin.data.channel_order import ORDERS
from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from eitskin.learn import models
from eitskin.paper.rows import rows
from eitskin.schema import Validator, one_of
from shared_data import shared_data

ROOT = Path(__file__).parents[3]
SCHEMA = ROOT / "workflow" / "schemas" / "config.schema.yaml"
CONFIG = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
EPSILON = ("configurations", "authors", "effects", 4, "parameters", "epsilon")


def changed(*place_and_value):
    *place, key, value = place_and_value
    config = json.loads(json.dumps(CONFIG))  # a copy in which YAML's aliases are apart
    node = config
    for part in place:
        node = node[part]
    node[key] = value
    return config


NOTATIONS = [  # of equal values
    ("radius_mm: 80.0  # the disc", "radius_mm: 80"),
    ("electrode_deg: [0.0, 22.5, 45.0,", "electrode_deg: [0, 22.5, 45,"),
    ("current_A: 0.001  # drive amplitude", "current_A: 1.0e-3"),
    ("{per_N: 0.005, F_mid_N: 5.0}", "{F_mid_N: 5, per_N: 0.005}"),
    (
        "{name: crosstalk, parameters: {epsilon: 0.03}}\n    noise: 0.01",
        "{parameters: {epsilon: 3.0e-2}, name: crosstalk}\n    noise: 0.010",
    ),
    ("{sd: 0.04, tie: mirror}", '{"tie": "mirror", "sd": 0.04}'),
    ("  radii: 8  # evenly from inner to outer\n  angles: 24", "  angles: 24\n  radii: 8"),
    ("probe_mm: 16.0", "probe_mm: 16"),
    ("mean_N: 5.0\n  sd_N: 2.0", "sd_N: 2\n  mean_N: 5"),
    ("session_frames: 300", "session_frames: 0x12c"),
    ("crossed: false  #", "crossed: no  #"),
    ("noise: 0.003", "noise: 3.0e-3"),
    ("{drive: adjacent, measure: adjacent}", "{measure: adjacent, drive: 'adjacent'}"),
    ("probes_mm: [7.0, 10.0, 15.0]", "probes_mm:\n      - 7\n      - 10\n      - 15"),
    (
        "{N_per_mm: 0.55, exponent: 1.5, scatter: 0.1}",
        "{scatter: 0.10, exponent: 1.5, N_per_mm: 0.55}",
    ),
    ("{ratio: {mean: 1.0, sd: 0.15}}", "{ratio: {sd: 0.15, mean: 1}}"),
    ("force_weight: 1.0  #", "force_weight: 1  #"),
    ("first: {samples: null, epochs: 40, seeds: 3}", "first: {seeds: 3, epochs: +40, samples: ~}"),
    ("force_weight: [1.0, 5.0, 20.0]", "force_weight: [1, 5, 20]"),
    ("seed: 1  # of everything", "seed: 1 # all"),
]


def test_equal_values_have_one_notation():
    text = (ROOT / "config.yaml").read_text(encoding="utf-8")
    config = json.dumps(canonical(CONFIG, SCHEMA))
    for written, other in NOTATIONS:
        assert written in text, written
        text = text.replace(written, other)
    assert json.dumps(canonical(yaml.safe_load(text), SCHEMA)) == config
    assert json.dumps(yaml.safe_load(text)) != json.dumps(CONFIG)


def test_the_notation_of_a_value_is_that_of_the_project_s_own():
    """In which results were made before."""
    flat = json.dumps(canonical(CONFIG, SCHEMA), sort_keys=True)
    assert flat == json.dumps(CONFIG, sort_keys=True)


def test_what_is_stated_of_a_skin_and_what_users_order_themselves():
    skins = ({"radius_mm": 40.0, "current_A": 1.0}, {"current_A": 1, "radius_mm": 40})
    written = [
        json.dumps(canonical(CONFIG | {"recordings": {"b": {"skin": skin}, "a": {}}}, SCHEMA))
        for skin in skins
    ]
    assert written[0] == written[1]
    assert list(json.loads(written[0])["recordings"]) == ["b", "a"]


@pytest.mark.parametrize(
    "names", [[], ["a"], ["a", "ab", "b-1", "b.2"], ["", "x"], ["skin-2", "skin-12"]]
)
def test_names_are_matched_and_nothing_else(names):
    words = {*names, "", "b", "b-", "bx2", "abc", "skin-1", "skin-22"}
    assert {word for word in words if re.fullmatch(any_of(names), word)} == set(names)


@pytest.fixture
def refusal(tmp_path, monkeypatch):
    """The one line with which a configuration, written to config.yaml, is refused."""
    monkeypatch.chdir(tmp_path)

    def line(config, written=None, overrides=()):
        text = yaml.safe_dump(config if written is None else written, allow_unicode=True)
        Path("config.yaml").write_text(text, encoding="utf-8")
        with pytest.raises(InputError) as refused:
            validate(config, SCHEMA, ["config.yaml", *overrides])
        assert "\n" not in str(refused.value)
        return str(refused.value)

    return line


def test_the_paper_s_configuration_is_accepted():
    validate(CONFIG, SCHEMA, [ROOT / "config.yaml"])


@pytest.mark.parametrize(
    ("place_and_value", "message"),
    [
        (
            ("sed", 1),
            "config.yaml: sed: found an unknown key, expected one of seed, ablation, accuracy",
        ),
        (
            ("figures", "recording", "x"),
            "config.yaml: figures.recording: found 'x', expected one of simulated-twin",
        ),
        (
            ("table_2", "configurations", ["authors", "x"]),
            "config.yaml: table_2.configurations[1]: found 'x', expected one of authors",
        ),
        (
            ("table_2", "permutations", 3),
            "config.yaml: table_2.permutations: found 3, expected 39 or more",
        ),
        (("seed", 1.5), "config.yaml: seed: found 1.5, expected a whole number"),
        (("seed", True), "config.yaml: seed: found True, expected a whole number"),
        (("seed", -1), "config.yaml: seed: found -1, expected 0 or more"),
        (
            ("skin", "radius_mm", float("nan")),
            "config.yaml: skin.radius_mm: found nan, expected a finite number",
        ),
        (("skin", None), "config.yaml: skin: found null, expected a mapping of keys"),
        (
            ("configurations", "text", "noise", "2e-2"),
            "config.yaml: configurations.text.noise: found '2e-2', expected a finite number "
            "(YAML reads 2e-2 as text; write 2.0e-2)",
        ),
        (
            (*EPSILON, "3e5"),
            "config.yaml: configurations.authors.effects[4].parameters.epsilon: found '3e5', "
            "expected a number, a list with one number a site, or {sd, mean, tie} to draw it anew "
            "for every session (YAML reads 3e5 as text; write 3.0e+5)",
        ),
        (
            (*EPSILON, {"sd": 1.0, "median": 0.0}),
            "config.yaml: configurations.authors.effects[4].parameters.epsilon.median: "
            "found an unknown key, expected one of mean, sd, tie",
        ),
        (
            ("configurations", "authors", "effects", 4, "parameters", {}),
            "config.yaml: configurations.authors.effects[4].parameters.epsilon: "
            "found no such key, expected a value",
        ),
        (
            ("configurations", "authors", "effects", 4, "parameters", "gain", 1.0),
            "config.yaml: configurations.authors.effects[4].parameters.gain: "
            "found an unknown key, expected one of epsilon",
        ),
        (
            ("configurations", "authors", "effects", 4, "name", "cross-talk"),
            "config.yaml: configurations.authors.effects[4].name: found 'cross-talk', "
            "expected one of crosstalk",
        ),
        (
            ("protocol", "drive", "skip"),
            "config.yaml: protocol.drive: found 'skip', expected adjacent, opposite or skip-<n>",
        ),
        (
            ("recordings", "my-skin", {"path": "nowhere.parquet"}),
            "config.yaml: recordings.my-skin.path: found no file 'nowhere.parquet', "
            "expected a recording's path",
        ),
        (
            ("table_1", "configurations", "autors", []),
            "config.yaml: table_1.configurations.autors: found an unknown name, "
            "expected one of authors, text",
        ),
        (("diagnoses", ["a-twin"]), "config.yaml: diagnoses[0]: found 'a-twin', expected one of"),
        (
            ("loop", "recordings", ["bench"]),
            "config.yaml: loop.recordings[0]: found 'bench', expected one of simulated-twin",
        ),
        (
            ("loop", "budget", "samples", None),
            "config.yaml: loop.budget.samples: found null, expected a whole number",
        ),
        (
            ("table_1", "recordings", "simulated-twin", ["continuous"]),
            "config.yaml: table_1.recordings.simulated-twin[0]: found 'continuous', "
            "expected one of random, place, session",
        ),
        (
            ("table_1", "recordings", "simulated-twin", {"continuous": ["mlp"]}),
            "config.yaml: table_1.recordings.simulated-twin.continuous: found an unknown key, "
            "expected one of place, random, session",
        ),
        (("limit", "samples", 0), "config.yaml: limit.samples: found 0, expected 2 or more"),
        (
            ("transfer", "sources", ["authors"]),
            "config.yaml: transfer.sources[0]: found 'authors', expected one of simulated-authors,",
        ),
        (
            ("transfer", "targets", ["simulated-twin", "bench"]),
            "config.yaml: transfer.targets[1]: found 'bench', expected one of simulated-twin",
        ),
        (("transfer", "models", ["gru"]), "config.yaml: transfer.models[0]: found 'gru'"),
        (
            ("table_1", "configurations", "authors", {"random": ["mlp", "gru"]}),
            "config.yaml: table_1.configurations.authors.random[1]: found 'gru', expected one of",
        ),
        (
            ("table_1", "recordings", "simulated-twin", ["random", "probe"]),
            "config.yaml: table_1.recordings.simulated-twin[1]: found 'probe', expected one of",
        ),
        (
            ("table_1", "recordings", "simulated-twin", "random"),
            "config.yaml: table_1.recordings.simulated-twin: found 'random', expected a list",
        ),
        (
            ("ablation", "varied_on", {"authors": ["random"]}),
            "config.yaml: ablation.varied_on.authors: found an unknown name, "
            "expected one of simulated-authors",
        ),
        (
            ("training", "rows", {"cnn": {"widths": [64]}}),
            "config.yaml: training.rows.cnn.widths: found [64], expected none, as it has its own",
        ),
        (
            ("training", "rows", {"svr": {"weight_decay": 0.1}}),
            "config.yaml: training.rows: found 'svr', expected one of mlp, cnn",
        ),
        (
            ("ablation", "grid", "force_weight", []),
            "config.yaml: ablation.grid.force_weight: found [], expected a list of 1 or more",
        ),
        (
            ("splits", ["place"]),
            "config.yaml: table_1.configurations.authors[0]: found 'random', expected one of place",
        ),
    ],
)
def test_a_mistake_gives_one_line(refusal, place_and_value, message):
    assert refusal(changed(*place_and_value)).startswith(message)


WIDTH = {"name": "electrode-width", "parameters": {"width_mm": 40.0}}
COMMON = {"name": "common-mode", "parameters": {"ratio": 0.01}}
DEEP = {"name": "third-dimension", "parameters": {"depth_mm": 20.0, "electrode_height_mm": 5.0}}
LEAK = {"name": "ground-leak", "parameters": {"siemens": 0.001}, "electrodes": [5]}
SWAP = {"name": "electrode-swap", "parameters": {}, "electrodes": [5, 6]}
GAIN = {"name": "channel-gain", "parameters": {"gain": 1.1}, "channels": [900]}


@pytest.mark.parametrize(
    ("place_and_value", "message"),
    [
        (
            ("twin", "skin", "electrode_width_mm", 31.5),
            "twin.skin.electrode_width_mm: found two that overlap, expected each an arc of its own",
        ),
        (
            ("skin", "electrode_deg", [0.0, 90.0, 180.0, 360.0]),
            "skin.electrode_deg: found two equal angles",
        ),
        (
            ("twin", "skin", "contact_impedivity_ohm_m2", 0.0),
            "twin.skin.contact_impedivity_ohm_m2: found 0, expected more than 0",
        ),
        (("skin", "radius_mm", 0.5), "skin.radius_mm: found 0.5, expected 1 or more"),
        (("skin", "radius_mm", 10**400), "skin.radius_mm: found 10"),
        (("skin", "thickness_mm", 2000), "skin.thickness_mm: found 2000, expected 1000 or less"),
        (
            ("twin", "skin", "contact_impedivity_ohm_m2", 1e-12),
            "twin.skin.contact_impedivity_ohm_m2: found 1e-12, expected contact impedivity, 0 or",
        ),
        (("skin", "current_A", 2.0), "skin.current_A: found 2.0, expected 1 or less"),
        (
            ("protocol", "measure", "skip-20"),
            "protocol.measure: found 'skip-20', expected a pair among 16",
        ),
        (
            ("twin", "protocol", "drive", "skip-15"),
            "twin.protocol.drive: found 'skip-15', expected a pair among 16",
        ),
        (
            (*EPSILON, 0.7),
            "configurations.authors.effects[4].parameters.epsilon: found 0.7, "
            "expected -0.25 to 0.25",
        ),
        (
            (*EPSILON, [0.1, 0.2]),
            "configurations.authors.effects[4].parameters.epsilon: found 2 values, expected one",
        ),
        (
            (*EPSILON, {"mean": 0.7, "sd": 0.0}),
            "configurations.authors.effects[4].parameters.epsilon: found 0.7, expected -0.25 to",
        ),
        (
            ("configurations", "text", "effects", 2, LEAK),
            "configurations.text.effects[2]: found points, with a leak to ground, expected "
            "a width above 0 (skin.electrode_width_mm)",
        ),
        (
            ("configurations", "text", "effects", 2, COMMON),
            "configurations.text.effects[2]: found channel ",
        ),
        (
            ("configurations", "text", "effects", 2, DEEP),
            "configurations.text.effects[2]: found 0, expected more than 0 for elec",
        ),
        (
            ("budgets", "first", "samples", 5),
            "budgets.first.samples: found 5, expected 6 or more",
        ),
        (
            ("configurations", "text", "continuous_samples", 600),
            "configurations.text.continuous_samples: found 600, expected 601 or more: three",
        ),
        (
            ("configurations", "text", "effects", 2, GAIN),
            "configurations.text.effects[2].channels: found [900], expected indices 0 to 207, once",
        ),
        (
            ("twin", "effects", 0, "drives", [3]),
            "twin.effects[0].drives: found [3], expected electrodes",
        ),
        (
            ("twin", "effects", 0, WIDTH),
            "twin.effects[0]: found two that overlap, expected each an arc of its own",
        ),
        (
            ("touch_grid", "inner", 0.95),
            "touch_grid.inner: found 0.95, expected at most outer, 0.9",
        ),
        (
            ("twin", "touch_grid", "outer", 0.05),
            "twin.touch_grid.inner: found 0.1, expected at most",
        ),
        (
            ("twin", "press", "target_N", [9.0, 8.0]),
            "twin.press.target_N: found [9.0, 8.0], expected the smaller force first",
        ),
        (("forces", "decimals", 0), "forces.levels: found 260, expected at most 11 at 0 decimals"),
    ],
)
def test_what_physics_cannot_do_is_refused_before_any_work(refusal, place_and_value, message):
    assert refusal(changed(*place_and_value)).startswith(f"config.yaml: {message}")


@pytest.mark.parametrize(
    ("crossed", "session_frames", "sessions"), [(False, 30_000, 2), (True, 25_000, 2)]
)
def test_too_few_sessions_to_split_are_refused_before_any_work(
    refusal, crossed, session_frames, sessions
):
    config = changed("configurations", "authors", "session_frames", session_frames)
    validate(config, SCHEMA, [ROOT / "config.yaml"])
    config["configurations"]["authors"]["crossed"] = crossed
    config["table_1"]["configurations"]["authors"] = ["random", "session"]
    expected = f"{session_frames}: {sessions} sessions of 49920 samples, expected fewer frames"
    place = "config.yaml: configurations.authors.session_frames: found"
    assert refusal(config).startswith(f"{place} {expected}")


def test_wires_of_points_may_be_swapped():
    validate(changed("configurations", "text", "effects", 2, SWAP), SCHEMA, [ROOT / "config.yaml"])


def test_a_protocol_without_channels_is_refused(refusal):
    config = changed("skin", "electrode_deg", [0.0, 90.0, 180.0, 270.0])
    config["protocol"]["measure"] = "opposite"
    assert refusal(config).startswith("config.yaml: protocol: found no channel is left with adj")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed: 1\nseed: 2\n", "seed: found it in line 1 and again in line 2, expected it once"),
        (
            "configurations:\n  own:\n    noise: 1\n    effects: []\n    noise: 2\n",
            "configurations.own.noise: found it in line 3 and again in line 5",
        ),
        ("list: [{a: 1}, {b: 1, b: 2}]\n", "list[1].b: found it in line 1 and again in line 1"),
    ],
)
def test_a_key_that_stands_twice_is_refused(refusal, text, message):
    Path("twice.yaml").write_text(text, encoding="utf-8")
    assert refusal(CONFIG, CONFIG, ["twice.yaml"]).startswith(f"twice.yaml: {message}")


def test_paths_are_taken_from_the_environment(refusal, tmp_path, monkeypatch):
    monkeypatch.setenv("CAPTURES", str(tmp_path / "captures"))
    mine = {"path": "${CAPTURES}/skin.parquet", "query": "${CAPTURES}/query.parquet"}
    config = changed("recordings", "my-skin", mine)
    message = "config.yaml: recordings.my-skin."
    assert refusal(config).startswith(message)
    (tmp_path / "captures").mkdir()
    for file in ("skin", "query"):
        (tmp_path / "captures" / f"{file}.parquet").touch()
    validate(config, SCHEMA, ["config.yaml"])
    assert config["recordings"]["my-skin"] == {
        "path": f"{tmp_path}/captures/skin.parquet",
        "query": f"{tmp_path}/captures/query.parquet",
    }
    monkeypatch.delenv("CAPTURES")
    unset = refusal(changed("recordings", "my-skin", {"path": "${CAPTURES}/skin.parquet"}))
    assert unset == (
        f"{message}path: found '${{CAPTURES}}/skin.parquet', but CAPTURES is not set, "
        "expected an environment variable that is set"
    )


def test_the_real_recordings_are_found_where_the_environment_says(monkeypatch):
    data = shared_data("README.md").parent
    monkeypatch.setenv("EITSKIN_DATA", str(data))
    real = yaml.safe_load((ROOT / "workflow" / "config" / "real.yaml").read_text(encoding="utf-8"))
    config = copy.deepcopy(CONFIG)
    config["recordings"] |= real["recordings"]
    config["table_1"]["recordings"] |= real["table_1"]["recordings"]
    validate(config, SCHEMA, [ROOT / "config.yaml"])
    assert config["recordings"]["lct-tank"]["path"] == f"{data}/lct-tank/homogeneous"


def test_a_missing_key_is_of_the_file_that_has_the_rest(refusal):
    Path("mine.yaml").write_text("budgets: {one: {epochs: 3}, first: {seeds: 2}}", encoding="utf-8")
    config = copy.deepcopy(CONFIG)
    config["budgets"]["one"] = {"epochs": 3}
    assert refusal(config, CONFIG, ["mine.yaml"]).startswith("mine.yaml: budgets.one.samples: ")
    del config["budgets"]["one"], config["budgets"]["first"]["epochs"]
    assert refusal(config, CONFIG, ["mine.yaml"]).startswith("config.yaml: budgets.first.epochs: ")


@pytest.mark.parametrize(
    ("text", "number"), [("-.5", "-0.5"), ("08", "8"), ("2e-2", "2.0e-2"), ("1.e5", "1.0e+5")]
)
def test_a_number_that_is_text_is_written_as_yaml_has_it(refusal, text, number):
    message = refusal(changed("twin", "noise", text))
    assert message.endswith(f"(YAML reads {text} as text; write {number})")
    assert isinstance(yaml.safe_load(number), int | float)


def test_a_number_that_a_command_line_makes_text_says_so(refusal):
    message = refusal(changed("limit", "samples", "100"))
    assert message.endswith(
        "(text here: without quotes it is a number in a file, but none within {} on a command line)"
    )


def test_the_example_that_trains_on_ones_own_recording_is_valid(tmp_path, monkeypatch):
    page = (ROOT / "docs" / "learning.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```yaml\n(recordings:.*?)^```$", page, re.DOTALL | re.MULTILINE)
    mine = yaml.safe_load(example)
    (tmp_path / "mine.yaml").write_text(example, encoding="utf-8")
    recording = tmp_path / mine["recordings"]["mine"]["path"]
    recording.parent.mkdir()
    recording.touch()
    monkeypatch.chdir(tmp_path)
    config = copy.deepcopy(CONFIG)
    config["recordings"] |= mine["recordings"]
    for kind in ("configurations", "recordings"):
        config["table_1"][kind] |= mine["table_1"][kind]
    validate(config, SCHEMA, [ROOT / "config.yaml", "mine.yaml"])
    assert {(dataset, split) for dataset, split, _ in rows(config)} == {("mine", "place")}


def test_a_missing_key_is_named_with_its_meaning(refusal):
    config = copy.deepcopy(CONFIG)
    del config["forces"]["mean_N"]
    expected = "forces.mean_N: found no such key, expected mean of the normal distribution in N"
    assert refusal(config) == f"config.yaml: {expected}"


def test_the_file_that_holds_the_mistake_is_named(refusal):
    Path("override.yaml").write_text("forces: {mean_N: '5'}\n", encoding="utf-8")
    message = refusal(changed("forces", "mean_N", "5"), CONFIG, ["override.yaml"])
    assert message.startswith("override.yaml: forces.mean_N: found '5'")


def test_a_mistake_that_no_file_holds_is_the_command_line_s(refusal):
    message = refusal(changed("budget", "smal"), CONFIG)
    assert message == "--config: budget: found 'smal', expected one of small, first, full"


def test_a_recording_may_not_take_the_name_of_a_simulated_set(refusal, tmp_path):
    recording = tmp_path / "recording.parquet"
    recording.touch()
    config = changed("recordings", "simulated-text", {"path": str(recording)})
    assert "recordings.simulated-text: found a simulated set's name" in refusal(config)


def test_the_schema_is_valid_and_closed_everywhere():
    rules = schema(SCHEMA)
    jsonschema.Draft202012Validator.check_schema(rules)

    def objects(node):
        if isinstance(node, dict):
            if "properties" in node and "name" not in node["properties"]:
                yield node
            for key, value in node.items():
                if key != "if" and key != "then":
                    yield from objects(value)
        elif isinstance(node, list):
            for value in node:
                yield from objects(value)

    found = list(objects(rules))
    assert len(found) > 15
    assert all(node["additionalProperties"] is not True for node in found)
    assert rules["$defs"]["effect"]["additionalProperties"] is False


def test_the_schema_s_names_are_those_that_the_code_has():
    written, rules = yaml.safe_load(SCHEMA.read_text(encoding="utf-8")), schema(SCHEMA)
    for place, names in (
        (("$defs", "effect", "properties", "name"), EFFECTS),
        (("$defs", "models", "items"), models.names()),
        (
            ("properties", "recordings", "additionalProperties", "properties", "format"),
            importers.format_names(),
        ),
        (("properties", "recordings", "additionalProperties", "properties", "order"), ORDERS),
    ):
        before, after = (functools.reduce(dict.get, place, node) for node in (written, rules))
        assert "enum" not in before and after["enum"] == list(names)


def test_an_effect_s_parameters_are_asked_for_by_name():
    """Each of those that may not be left out is missed, and no other is known."""
    rules = Validator({"$ref": "#/$defs/effect", "$defs": schema(SCHEMA)["$defs"]})
    for name, effect in EFFECTS.items():
        given = {
            key: parameter.neutral if parameter.neutral is not None else 1
            for key, parameter in effect.parameters.items()
        }
        assert rules.is_valid({"name": name, "parameters": given})
        assert not rules.is_valid({"name": name, "parameters": {**given, "other": 1}})
        for key, parameter in effect.parameters.items():
            less = {other: value for other, value in given.items() if other != key}
            assert rules.is_valid({"name": name, "parameters": less}) == parameter.optional


def test_names_that_resemble_what_was_found_come_first():
    known = ["accuracy", "budget", "learning_rate", "weight_decay"]
    expected = "one of learning_rate, accuracy, budget, weight_decay"
    assert one_of(known, "learning_rte") == expected
    assert one_of(known, 7) == "one of " + ", ".join(known)
