"""A rig in the workflow's configuration: one more recording once it is captured, none before."""

import copy
import json
from pathlib import Path

import pytest
import yaml

from eitskin.capture import configuration
from eitskin.capture.attachment import attach, manifest_path
from eitskin.capture.press_plan import plan_sha256
from eitskin.configuration import captured_path, validate
from eitskin.errors import InputError

ROOT = Path(__file__).parents[3]
SCHEMA = ROOT / "workflow" / "schemas" / "config.schema.yaml"
CONFIG = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
RIG = yaml.safe_load((ROOT / "workflow" / "config" / "rig.yaml").read_text(encoding="utf-8"))["rig"]
NAME, FILE = "gel", "my-rig.yaml"


@pytest.fixture
def config(tmp_path, monkeypatch):
    """A configuration with a rig, its capture named wherever recordings are."""
    monkeypatch.chdir(tmp_path)
    configuration = json.loads(json.dumps(CONFIG))
    configuration["rig"] = {**copy.deepcopy(RIG), "name": NAME}
    configuration["table_1"]["recordings"][NAME] = ["place"]
    for key in ("varied_on", "compared_on"):
        configuration["ablation"][key][NAME] = ["random"]
    for names in (
        configuration["diagnoses"],
        configuration["transfer"]["targets"],
        configuration["tanks"],
    ):
        names.append(NAME)
    configuration["loop"]["recordings"].append(NAME)
    return configuration


def attached(config):
    """The configuration as the workflow has it, read from one file."""
    Path(FILE).write_text(yaml.safe_dump(config), encoding="utf-8")
    validate(config, SCHEMA, [FILE])
    attach(config, [FILE])
    return config


def refusal(config):
    """The one line with which it is refused."""
    with pytest.raises(InputError) as refused:
        attached(config)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def capture(config, **manifest):
    """What a capture leaves behind, as far as it is looked at."""
    path = Path(captured_path(NAME))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"PAR1")
    manifest = {"plan_sha256": plan_sha256(config["rig"]), **manifest}
    Path(manifest_path(NAME)).write_text(json.dumps(manifest), encoding="utf-8")


def test_a_recording_that_is_not_captured_is_left_out_of_everything(config, capsys):
    assert NAME not in json.dumps({**attached(config), "rig": None})
    assert f"{NAME} is not captured yet" in capsys.readouterr().err


def test_nothing_else_is_left_out(config):
    remaining = json.loads(json.dumps(attached(config)))
    del remaining["rig"]
    assert remaining == json.loads(json.dumps(CONFIG))


def test_a_captured_one_is_a_recording_and_stays_wherever_it_is_named(config, capsys):
    capture(config)
    expected = json.loads(json.dumps(config))
    expected["recordings"][NAME] = {"path": captured_path(NAME)}
    assert json.loads(json.dumps(attached(config))) == expected
    assert capsys.readouterr().err == ""


def test_a_captured_one_may_have_a_query(config):
    Path("q.parquet").touch()
    config["recordings"][NAME] = {"path": captured_path(NAME), "query": "q.parquet"}
    capture(config)
    assert attached(config)["recordings"][NAME]["query"] == "q.parquet"


@pytest.mark.parametrize("missing", [captured_path(NAME), manifest_path(NAME)])
def test_half_a_capture_is_none(config, missing):
    capture(config)
    Path(missing).unlink()
    assert NAME not in attached(config)["recordings"]


def test_a_capture_by_another_plan_is_refused(config):
    capture(config)
    config["rig"]["plan"]["step_mm"] = 0.5
    assert refusal(config).startswith(f"{FILE}: rig: found another rig or plan, expected that of")


@pytest.mark.parametrize("text", ["{", "[]"])
def test_a_manifest_that_is_none_is_refused(config, text):
    capture(config)
    Path(manifest_path(NAME)).write_text(text, encoding="utf-8")
    assert refusal(config).startswith(f"{manifest_path(NAME)}: file: found")


def test_figures_of_what_is_not_captured_are_refused(config):
    config["figures"]["recording"] = NAME
    assert "figures.recording: found gel, which is not captured yet" in refusal(config)
    capture(config)
    assert attached(config)["figures"]["recording"] == NAME


@pytest.mark.parametrize("path", [captured_path(NAME), f"results/../{captured_path(NAME)}"])
@pytest.mark.parametrize("key", ["path", "query"])
def test_another_recording_of_what_is_not_captured_is_refused(config, key, path):
    Path("other.parquet").touch()
    config["recordings"]["other"] = {"path": "other.parquet", key: path}
    assert f"recordings.other.{key}: found gel, which is not captured yet" in refusal(config)
    capture(config)
    attached(config)


def test_the_name_of_another_recording_is_refused(config):
    Path("other.parquet").touch()
    config["recordings"][NAME] = {"path": "other.parquet"}
    assert "rig.name: found gel, a recording's, expected another" in refusal(config)


def test_a_simulated_set_s_name_is_refused():
    configuration = {**CONFIG, "rig": {**RIG, "name": "simulated-authors"}}
    with pytest.raises(InputError, match=r"rig\.name: found a simulated set's name"):
        validate(configuration, SCHEMA, [])


def test_a_rig_is_refused_by_its_own_schema(config):
    assert refusal({**config, "rig": 3}) == f"{FILE}: rig: found 3, expected a mapping of keys"
    config["rig"]["limits"]["soft"] = 1.0
    assert f"{FILE}: rig.limits.soft: found an unknown key" in refusal(config)


def test_what_is_valid_by_its_schema_is_not_validated_again(config, monkeypatch):
    Path(FILE).write_text(yaml.safe_dump(config), encoding="utf-8")
    monkeypatch.setattr(configuration, "SCHEMA", Path("absent.yaml"))
    attach(config, [FILE])
    config["rig"]["motion"]["press_m_s"] = 0.02
    with pytest.raises(InputError, match=r"rig\.motion: found 0\.02 m/s"):
        attach(config, [FILE])


def test_a_probe_that_is_on_no_rig_is_refused(config):
    del config["rig"]
    for names in (
        config["table_1"]["recordings"],
        *(config["ablation"][key] for key in ("varied_on", "compared_on")),
    ):
        del names[NAME]
    for names in (config["diagnoses"], config["transfer"]["targets"], config["tanks"]):
        names.remove(NAME)
    config["loop"]["recordings"].remove(NAME)
    validate(config, SCHEMA, [])
    config["mounted_mm"] = 7
    with pytest.raises(InputError, match="mounted_mm: found 7 mm, expected a rig that the probe"):
        validate(config, SCHEMA, [])


def test_a_rig_that_cannot_be_driven_safely_is_refused(config):
    config["rig"]["motion"]["press_m_s"] = 0.02
    assert f"{FILE}: rig.motion: found 0.02 m/s: the force grows by 16.8 N" in refusal(config)


def test_a_capture_that_is_gone_is_refused_where_no_rig_is_attached(config):
    del config["rig"]
    config["recordings"][NAME] = {"path": captured_path(NAME)}
    assert f"recordings.gel.path: found no file '{captured_path(NAME)}'" in refusal(config)
    Path(captured_path(NAME)).parent.mkdir(parents=True)
    Path(captured_path(NAME)).touch()
    validate(config, SCHEMA, [FILE])
