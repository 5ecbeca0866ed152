"""Broken configurations, one a row: what stands at a place, and what the one line says."""

import json
from pathlib import Path

import pytest
import yaml

from eitskin.configuration import validate
from eitskin.errors import InputError

ROOT = Path(__file__).parents[3]
SCHEMA = ROOT / "workflow" / "schemas" / "config.schema.yaml"
CONFIG = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
NAN, INF = float("nan"), float("inf")
AUTHORS = "configurations authors"
GAIN = {"name": "channel-gain", "parameters": {"gain": 1.0}}

VALUES = [  # keys on the way, a value, and what was found and expected
    ("sed", 1, "an unknown key", "one of seed, ablation"),
    ("seed", None, "null", "a whole number"),
    ("seed", "one", "'one'", "a whole number"),
    ("seed", 1.5, "1.5", "a whole number"),
    ("seed", 10**30, "1000000", "4294967295 or less"),
    ("skin", [], "[]", "a mapping of keys"),
    ("skin radius_mm", 0, "0", "1 or more"),
    ("skin radius_mm", NAN, "nan", "a finite number"),
    ("skin radius_mm", 10**400, "1000", "a finite number"),
    ("skin radius", 80.0, "an unknown key", "radius_mm"),
    ("skin electrode_deg", [0.0] * 16, "[0.0", "without repetition"),
    ("skin electrode_deg", [0.0, 360.0, 90.0, 180.0], "two equal angles", "one an electrode"),
    ("skin electrode_deg", [0.0, 90.0, 180.0], "[0.0", "a list of 4 or more"),
    ("skin electrode_width_mm", 40.0, "overlap", "an arc of its own"),
    ("skin contact_impedivity_ohm_m2", 1e-12, "1e-12", "1e-9 to 10"),
    ("skin current_A", -1, "-1", "1e-09 or more"),
    ("protocol drive", "sideways", "'sideways'", "adjacent, opposite or skip-<n>"),
    ("protocol drive", "skip-15", "'skip-15'", "a pair among 16"),
    ("protocol drive", "skip-" + "9" * 5000, "'skip-9", "adjacent, opposite or skip-<n>"),
    ("protocol channels", [[0, 1, 2]], "[0, 1, 2]", "a list of 4"),
    ("protocol channels", [[0, 1, 2, 99]], "[0, 1, 2, 99]", "0 to 15"),
    ("protocol channels", [[0, 0, 2, 3]], "[0, 0, 2, 3]", "different electrodes"),
    ("touch_grid radii", 10**9, "1000000000", "1000 or less"),
    ("touch_grid inner", 0.95, "0.95", "at most outer, 0.9"),
    ("touch_grid probe_mm", 0, "0", "more than 0"),
    ("forces levels", 10**9, "1000000000", "10000 or less"),
    ("forces levels", 5000, "5000", "at most 1001 at 2 decimals"),
    ("forces levels", 0, "0", "1 or more"),
    ("forces decimals", 10, "10", "9 or less"),
    ("forces sd_N", "2e0", "'2e0'", "write 2.0e+0"),
    ("accuracy", "best", "'best'", "one of train, diagnose"),
    ("configurations", {}, "{}", "1 or more keys"),
    ("configurations Authors", CONFIG["configurations"]["text"], "'Authors'", "a-z, 0-9 and -"),
    (f"{AUTHORS} noise", "2e-2", "'2e-2'", "write 2.0e-2"),
    (f"{AUTHORS} noise", -0.1, "-0.1", "0 or more"),
    (f"{AUTHORS} session_frames", 10**30, "1000000", "1000000 or less"),
    (f"{AUTHORS} baseline", "none", "'none'", "one of paired, averaged"),
    (f"{AUTHORS} crossed", "yes", "'yes'", "true or false"),
    (f"{AUTHORS} effects", {"name": "gain"}, "{'name'", "a list"),
    (f"{AUTHORS} effects 0", {"name": "gian", "parameters": {}}, "'gian'", "one of adc-non"),
    (f"{AUTHORS} effects 0", {"name": "channel-gain"}, "no such key", "parameters of the effect"),
    (f"{AUTHORS} effects 0", GAIN | {"channels": [208]}, "[208]", "indices 0 to 207"),
    (f"{AUTHORS} effects 0", GAIN | {"channels": [1, 1]}, "[1, 1]", "without repetition"),
    (f"{AUTHORS} effects 4 parameters epsilon", 0.9, "0.9", "-0.25 to 0.25"),
    (f"{AUTHORS} effects 4 parameters epsilon", {"mean": 1}, "no such key", "standard deviation"),
    (f"{AUTHORS} effects 4 parameters epsilon", [], "[]", "a list of 1 or more"),
    ("recordings x", {"path": "absent.parquet"}, "no file 'absent.parquet'", "recording's path"),
    ("recordings x", {"path": ""}, "''", "file or folder"),
    ("recordings x", {"path": "x" * 5000}, "no file 'xxx", "a recording's path"),
    ("recordings x", {"path": "a\0b"}, "no file 'a", "a recording's path"),
    ("recordings x", {"path": "${ABSENT_VARIABLE}/a"}, "ABSENT_VARIABLE is not set", "that is set"),
    ("recordings x", {"path": ".", "format": "csv"}, "'csv'", "one of eit-recording"),
    ("recordings x", {"path": ".", "skin": {"radius": 3}}, "'radius'", "one of radius_mm"),
    ("recordings x", {"path": ".", "skin": {"radius_mm": -3}}, "-3", "more than 0"),
    ("recordings ../x", {"path": "."}, "'../x'", "a name of a-z"),
    ("twin press target_N", [5.0, 1.0], "[5.0, 1.0]", "the smaller force first"),
    ("twin press sessions_per_probe", 10**9, "1000000000", "1000 or less"),
    ("splits", ["random", "random"], "['random', 'random']", "without repetition"),
    ("models", ["svm"], "'svm'", "one of svr, mlp"),
    ("training learning_rate", 0, "0", "more than 0"),
    ("training epochs", 10, "10", "this key in budgets.NAME, not here"),
    ("training epoch", 10, "an unknown key", "one of batch_size, force_weight, lambda_latent"),
    ("training latent_dim", 10**12, "1000000000000", "4096 or less"),
    ("budgets small epochs", 10**30, "1000000", "1000000 or less"),
    ("budget", "medium", "'medium'", "one of first, small, full"),
    ("table_1 configurations nobody", ["random"], "an unknown name", "one of authors"),
    ("table_2 permutations", 10**9, "1000000000", "1000000 or less"),
    ("figures configuration", "nobody", "'nobody'", "one of authors"),
    ("transfer sources", ["authors"], "'authors'", "one of simulated-authors"),
    ("diagnoses", ["my-skin"], "'my-skin'", "one of simulated-twin"),
    ("concealed blocks final seed", 1, "1", "null"),
    ("loop cases single:nothing", [1], "'single:nothing'", "single:<effect>"),
    ("loop share", 2, "2", "1 or less"),
    ("mounted_mm", 8.0, "8 mm", "a rig"),
]
TEXTS = [  # a whole file
    ("no closing bracket", b"seed: [1\n", "line 2, column 1", "the end of the file", "',' or ']'"),
    ("a tab", b"skin:\n\tradius_mm: 3\n", "line 2, column 1", "a tab", "spaces"),
    ("after a bracket", b"a: [1] 2\n", "line 1, column 8", "something behind the end", "YAML"),
    ("indented", b"a:\n  b: 1\n c: 2\n", "line 3, column 2", "indented otherwise", "YAML"),
    ("a second colon", b"a: b: c\n", "line 1, column 5", "a second colon", "key: value"),
    ("Latin-1", b"# f\xfcr\n", "line 1", "byte 0xfc", "UTF-8"),
    ("UTF-16", "seed: 1\n".encode("utf-16"), "line 1", "UTF-16", "UTF-8"),
    ("nothing", b"", "file", "nothing", "a mapping"),
    ("a list", b"- seed\n", "file", "a list", "a mapping"),
    ("a key twice", b"seed: 1\nseed: 2\n", "seed", "line 1 and again in line 2", "it once"),
    ("code", b"seed: !!python/name:os.system\n", "line 1, column 7", "constructor", "YAML"),
    ("a template", b"__use_yte__: true\nseed: 1\n", "__use_yte__", "runs code", "plain YAML"),
    ("a date that is none", b"seed: 2020-99-99\n", "file", "month", "YAML"),
]


def with_value(place: str, value: object) -> dict:
    """The configuration with another value; numbers in `place` are indices."""
    config = json.loads(json.dumps(CONFIG))
    *way, last = [int(key) if key.isdigit() else key for key in place.split()]
    node = config
    for key in way:
        node = node[key]
    node[last] = value
    return config


@pytest.mark.parametrize(
    ("place", "value", "found", "expected"),
    VALUES,
    ids=[f"{place}-{k}" for k, (place, *_) in enumerate(VALUES)],
)
def test_a_broken_value_is_refused_in_one_line(
    tmp_path, monkeypatch, place, value, found, expected
):
    monkeypatch.chdir(tmp_path)
    config = with_value(place, value)
    own = {place.split()[0]: config[place.split()[0]]}
    Path("mine.yaml").write_text(yaml.safe_dump(own, allow_unicode=True), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        validate(config, SCHEMA, [ROOT / "config.yaml", "mine.yaml"])
    error = refused.value
    assert found in str(error.actual) and expected in error.expected, str(error)
    assert "\n" not in str(error) and Path(error.file).name == "mine.yaml"
    assert error.place.startswith(place.split()[0])


@pytest.mark.parametrize(
    ("text", "place", "found", "expected"), [row[1:] for row in TEXTS], ids=[r[0] for r in TEXTS]
)
def test_a_broken_file_is_refused_in_one_line(tmp_path, monkeypatch, text, place, found, expected):
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_bytes(text)
    with pytest.raises(InputError) as refused:
        validate(CONFIG, SCHEMA, [ROOT / "config.yaml", "mine.yaml"])
    error = refused.value
    assert str(error.file) == "mine.yaml" and error.place == place, str(error)
    assert found in str(error.actual) and expected in error.expected, str(error)
