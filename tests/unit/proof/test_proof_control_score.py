"""Hand-made rows of controls, scored by hand."""

import json

import pytest

from proof import score
from proof.blocks import trials
from proof.control_score import scored, standard_errors
from proof.trial import file_of

NOTHING = {"verdict": "consistent", "effects": [], "other": {"probability": 0.1}}


def effect(name, certain=True, alternatives=(), **parameters):
    estimates = {k: {"low": low, "high": high} for k, (low, high) in parameters.items()}
    sites = {key: [] for key in ("electrodes", "drives", "measures", "channels")}
    said = {"name": name, "certain": certain, "alternatives": list(alternatives)}
    said["scope"] = "common"
    return {**said, **sites, "parameters": estimates}


def row(kind, seed=1, effects=(), components=(), unlabelled=(), truth=(), **more):
    noise = {"components": list(components), "unlabelled": list(unlabelled)}
    said = {**NOTHING, "effects": list(effects), "noise": noise}
    return {
        "kind": f"control:{kind}",
        "seed": seed,
        "code": "a",
        "seconds": 10.0,
        "level": 1e-3,
        "generator": "disc",
        "truth": [{"name": name, "parameters": {}} for name in truth],
        "scopes": ["common"] * len(truth),
        "true_gaps": [[]] * len(truth),
        "snr": [500.0] * len(truth),
        "outside": None,
        "rig": [],
        "common": None,
        "unlabelled": [],
        "said": said,
        **more,
    }


def broken(kind, seed=9):
    return {"kind": f"control:{kind}", "seed": seed, "code": "a", "failed": "ValueError()"}


def counts(rows, of, what):
    table = scored(rows)[0]["summary"]
    (line,) = table[(table["of"] == of) & (table["what"] == what)].to_dict("records")
    return line["hits"], line["n"]


def common(name, own=1.0, presses=16, snr=1e9, **parameters):
    return {"name": name, "parameters": parameters, "own": own, "presses": presses, "snr": snr}


def test_a_null_s_candidates_are_names_and_its_findings_certain():
    rows = [
        row("white-0.01"),
        row("white-0.1", effects=[effect("offset", certain=False)]),
        row("white-1", effects=[effect("offset")]),
        broken("white-1"),
        row("single-frame", effects=[effect("offset")]),
    ]
    assert counts(rows, "nulls of white noise", "a certain name") == (2, 4)
    assert counts(rows, "nulls of white noise", "any name") == (3, 4)
    assert counts(rows, "nulls of white noise", "a certain name, 1 %") == (2, 2)
    assert counts(rows, "nulls of white noise", "any name, 0.1 %") == (1, 1)


def test_an_alarm_is_a_name_other_physics_or_a_verdict():
    loud = [
        row("single-frame", effects=[effect("offset", certain=False)]),
        row("single-frame"),
        row("averaged-frames"),
        broken("averaged-frames"),
    ]
    loud[1]["said"]["other"] = {"probability": 0.5}
    loud[2]["said"]["verdict"] = "unexplained"
    rows = [*loud, row("single-frame"), row("white-1", effects=[effect("offset")])]
    assert counts(rows, "untouched frames", "any alarm") == (4, 5)
    assert counts(rows, "untouched frames", "any alarm, single frames") == (2, 3)


def test_frames_without_a_label_are_counted():
    press = [{"first": 11, "last": 14, "snr": [2.0, 9.0, 9.0, 9.0]}]
    rows = [
        row("unlabelled-white", unlabelled=[[11, 14]]),
        row("unlabelled-white", unlabelled=[[12, 15]]),
        row("unlabelled-alien", effects=[effect("mains-interference")]),
        row("unlabelled-alien"),
        broken("unlabelled-alien"),
    ]
    for made in rows[:-1]:
        made["unlabelled"] = press
    rows[3]["said"]["steps"] = [{}]
    of = "presses without a label"
    table = scored(rows)[0]["summary"].set_index(["of", "what"])["value"]
    assert table[of, "share of their frames that is named"] == pytest.approx(1.75 / 5)
    plain = "share of their frames of SNR 8 or more that is named"
    assert table[of, plain] == pytest.approx(2.0 / 5)
    assert counts(rows, of, "nine of ten of their frames named") == (1, 5)
    assert counts(rows, of, "a frame wrongly named") == (2, 5)
    assert counts(rows, of, "a certain name or a step, of which none is true") == (3, 5)


def test_the_common_part_s_interval_is_the_effect_s_or_the_noise_s():
    part = common("registration", dx_mm=1.0, dy_mm=-1.0)
    shared = {"name": "place-per-press", "unit": "mm"}
    far = {**shared, "common": {"low": [0.5, 0.5], "high": [1.5, 1.5]}}
    named = effect("registration", dx_mm=(0.9, 1.1), dy_mm=(-1.1, -0.9))
    rows = [
        row("common-place", effects=[named], components=[far], common=part),
        row("common-place", components=[{**shared, "name": "place-per-frame"}, far], common=part),
        row("common-place", components=[{**far, "name": "force-per-press"}], common=part),
        broken("common-place"),
    ]
    of = "places off alike"
    intervals = "90 % intervals that hold the common part, "
    assert counts(rows, of, intervals + "a miss where none is stated") == (3, 8)
    assert counts(rows, of, intervals + "of those stated") == (3, 4)
    assert counts(rows, of, "an interval of the common part stated") == (2, 4)
    assert standard_errors(rows[0]) == pytest.approx(16.45, rel=1e-3)
    assert standard_errors(rows[1]) == pytest.approx(3.29, rel=1e-3)
    assert standard_errors(rows[2]) == pytest.approx(2**0.5 * 4.0)  # own / sqrt(presses)
    assert counts(rows, of, "named, at 4 standard errors or more") == (1, 3)


def test_a_factor_s_share_in_the_noise_is_about_one():
    component = {"name": "force-per-press", "unit": "1", "common": {"low": 0.04, "high": 0.06}}
    part = common("touch-contrast", ratio=1.05)
    rows = [
        row("common-force-factor", components=[component], common=part),
        row(
            "common-force-factor",
            effects=[effect("contact-law", alternatives=["touch-contrast"])],
            components=[component],
            common=part,
        ),
    ]
    assert standard_errors(rows[0]) == pytest.approx(8.224, rel=1e-3)
    of = "a factor of the load cell"
    held = "90 % intervals that hold the common part, of those stated"
    assert counts(rows, of, held) == (2, 2)
    assert counts(rows, of, "named, at 4 standard errors or more") == (1, 2)
    assert counts(rows, "forces off alike", held) == (2, 2)


def test_a_delay_of_the_pose_has_no_name():
    part = common(None, delay_s=0.2, own=0.01)
    rows = [row("delay-pose", effects=[effect("force-lag", lag_s=(0.1, 0.3))], common=part)]
    assert counts(rows, "delays", "named, at 4 standard errors or more") == (0, 1)
    assert counts(rows, "delays", "an interval of the common part stated") == (0, 1)


def test_a_pair_is_right_where_both_are_named_and_nothing_else():
    pair = ("crosstalk", "force-lag")
    both = [effect(name) for name in pair]
    rows = [
        row("strong-pair", effects=both, truth=pair),
        row("strong-pair", effects=both[:1], truth=pair),
        row("strong-pair", effects=[*both, effect("offset")], truth=pair),
        broken("strong-pair"),
    ]
    of = "pairs 400 to 1,500 times the noise"
    assert counts(rows, of, "both named, nothing else") == (1, 4)


def test_a_part_of_a_block_is_written_with_a_row_a_recording(tmp_path):
    plan = trials("controls-report", "quick")[:6]
    for kind, seed in plan:
        part = common("registration", dx_mm=1.0, dy_mm=-1.0)
        name = kind.partition(":")[2]
        made = row(name, seed, common=part if "common" in name or "delay" in name else None)
        path = file_of(tmp_path / "trials", kind, seed)
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(made))
    score.write(tmp_path, "controls-report", "quick")
    assert {path.name for path in tmp_path.glob("*.*")} == {
        "summary.csv",
        "summary.md",
        "controls.csv",
    }
    assert "6 of 58 recordings" in (tmp_path / "summary.md").read_text()
    assert len((tmp_path / "controls.csv").read_text().splitlines()) == 7
