"""Hand-made rows, scored by hand."""

import json
import math

import numpy as np
import pytest

from proof import figures, measures, p_value_score, rig_sizes, score
from proof.blocks import trials
from proof.claims import Words
from proof.intervals import bootstrap, wilson
from proof.judge import covered, matched, names_truth, next_gap
from proof.trial import file_of

HIDDEN = {
    "rmse_V": 1.0,
    "rmse_before_V": 10.0,
    "rmse_gp_V": 5.0,
    "rmse_mlp_V": 4.0,
    "chi2_per_dof": 1.1,
    "within_90": 0.9,
}


def found(name, alternatives=(), **given):
    """An effect of a diagnosis; parameters as key=(value, low, high)."""
    sites = {k: given.pop(k, []) for k in ("electrodes", "drives", "measures", "channels")}
    parameters = {k: dict(zip(("value", "low", "high"), v, strict=True)) for k, v in given.items()}
    return {"name": name, "alternatives": list(alternatives), **sites, "parameters": parameters}


def row(kind, seed, said=(), truth=(), gaps=(), scopes=None, probability=0.1, **more):
    fit = {"chi2_per_dof_before": 4.0, "chi2_per_dof_after": 1.0}
    return {
        "kind": kind,
        "seed": seed,
        "code": "a",
        "seconds": 10.0 * seed,
        "truth": list(truth),
        "scopes": scopes or ["common"] * len(truth),
        "true_gaps": list(gaps),
        "outside": None,
        "snr_left": 0.0,
        "said": {
            "verdict": "explained" if said else "consistent",
            "effects": list(said),
            "other": {"probability": probability},
            "fit": {"held_out": fit},
        },
        "hidden": HIDDEN,
        **more,
    }


def line(table, of, what):
    (one,) = table[(table["of"] == of) & (table["what"] == what)].to_dict("records")
    return one


def test_wilson_s_interval():
    # Brown, Cai, DasGupta 2001: 0 of 10 and its mirror; the rest by the formula.
    assert wilson(0, 10) == pytest.approx((0.0, 0.27753), abs=1e-5)
    assert wilson(10, 10) == pytest.approx((0.72247, 1.0), abs=1e-5)
    assert wilson(3, 150) == pytest.approx((0.006827, 0.057140), abs=1e-5)
    assert np.isnan(wilson(0, 0)).all()


def test_a_bootstrap_interval_is_the_mean_s():
    values = np.random.default_rng(0).standard_normal(400)
    low, high = bootstrap(400, lambda i: float(values[i].mean()))
    half = 1.96 * values.std() / 20
    assert (low, high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.02)
    assert (low, high) == bootstrap(400, lambda i: float(values[i].mean()))


def test_the_gap_is_to_the_nearest_name_outside_the_class():
    assert next_gap([("a", 1.0), ("b", 2.9), ("c", 9.0), ("d", 12.0)]) == 9.0
    assert next_gap([]) == math.inf
    assert math.isnan(next_gap([("a", 1.0)]))
    assert math.isnan(next_gap(None))


@pytest.mark.parametrize(
    ("name", "alternatives", "right"),
    [
        ("offset", [], True),
        ("offset", ["common-mode"], True),  # 2: of the class
        ("offset", ["drive-gain"], True),  # 4.5: near
        ("offset", ["channel-gain"], False),  # 6: told apart
        ("offset", ["crosstalk"], False),  # not even a rival
        ("common-mode", ["offset"], True),
        ("common-mode", [], False),
        ("channel-gain", ["offset"], False),
    ],
)
def test_a_name_is_right_alone_or_in_its_class(name, alternatives, right):
    gaps = [("common-mode", 2.0), ("drive-gain", 4.5), ("channel-gain", 6.0)]
    assert names_truth(found(name, alternatives), "offset", gaps) == right


def test_one_found_effect_names_one_true_one_and_names_come_first():
    a, b = {"name": "touch-contrast"}, {"name": "contact-law"}
    near = [[("contact-law", 1.0)], [("touch-contrast", 1.0)]]
    law = found("contact-law", ["touch-contrast"])
    assert matched(row("pair", 1, [law], [a, b], near)) == [None, law]
    both = [law, found("touch-contrast", ["contact-law"])]
    assert matched(row("pair", 1, both, [a, b], near)) == both[::-1]


def test_angles_count_modulo_their_period():
    item = {"name": "anisotropy", "parameters": {"ratio": 1.1, "angle_deg": 178.0}}
    same = found("anisotropy", ratio=(1.1, 1.0, 1.2), angle_deg=(-1.0, -4.0, 2.0))
    assert covered(same, item, "common") == [True, True]
    turned = found("anisotropy", ratio=(1.2, 1.15, 1.25), angle_deg=(88.0, 86.0, 90.0))
    assert covered(turned, item, "common") == [False, False]


def test_another_harmonic_covers_nothing_and_a_size_has_no_phase():
    shape = {"harmonic": 2, "amplitude": 0.01, "phase_deg": 30.0}
    item = {"name": "domain-shape", "parameters": shape}
    values = {"amplitude": (0.01, 0.009, 0.011), "phase_deg": (390.0, 385.0, 395.0)}
    assert covered(found("domain-shape", harmonic=(2, 2, 2), **values), item, "common") == [1, 1]
    assert covered(found("domain-shape", harmonic=(3, 3, 3), **values), item, "common") == [0, 0]
    size = {"name": "domain-shape", "parameters": {**shape, "harmonic": 0, "phase_deg": 0.0}}
    assert covered(found("domain-shape", harmonic=(0, 0, 0), **values), size, "common") == [True]


def test_lists_are_compared_site_by_site():
    item = {"name": "contact-impedance", "electrodes": [3, 9], "parameters": {"ratio": [2.0, 1.5]}}
    ratio = ([1.5, 2.1, 1.0], [1.4, 2.05, 0.9], [1.6, 2.2, 1.1])
    assert covered(
        found("contact-impedance", electrodes=[9, 3, 4], ratio=ratio), item, "sparse"
    ) == [
        False,
        True,
    ]
    one = found("contact-impedance", electrodes=[3], ratio=(2.0, 1.9, 2.1))
    assert covered(one, item, "sparse") == [True]
    common = found("contact-impedance", ratio=(2.0, 1.9, 2.1))
    assert covered(common, item, "sparse") == [True, False]
    offset = {"name": "offset", "measures": [3], "parameters": {"volt": [1e-3]}}
    assert covered(found("offset", channels=[5], volt=(1e-3, 0.0, 1.0)), offset, "sparse") == []


def test_dense_gains_are_known_up_to_a_factor():
    item = {
        "name": "drive-gain",
        "drives": [0, 1, 2],
        "parameters": {"gain": [1.1, 0.9, 1.0]},
    }
    gain = np.array([1.1, 0.9, 1.2]) / 1.05
    said = found("drive-gain", drives=[0, 1, 2], gain=(gain, gain - 1e-6, gain + 1e-6))
    said["parameters"]["gain"] = {k: v.tolist() for k, v in said["parameters"]["gain"].items()}
    assert covered(said, item, "dense") == [True, True, False]
    assert covered(said, item, "sparse") == [False] * 3


def test_another_law_covers_nothing_and_what_is_open_does_not_count():
    item = {"name": "adc-nonlinearity", "parameters": {"limit_V": 0.4}}
    assert covered(found("adc-nonlinearity", cubic=(1.0, 0.0, 2.0)), item, "common") == [False]
    free = {"name": "force-dependent-impedance", "parameters": {"per_N": 0.1, "range_mm": None}}
    near = found("force-dependent-impedance", per_N=(0.1, 0.0, 0.2))
    assert covered(near, free, "common") == [True]


def test_false_alarms_are_counted():
    rows = [row("null", i) for i in (1, 2)]
    rows += [row("null", 3, [found("offset")], probability=0.7)]
    rows += [{"kind": "null", "seed": 4, "failed": "LinAlgError()"}]
    table = score.diagnoses_summary(rows)
    alarms = line(table, "nothing left out", "an effect named")
    assert (alarms["hits"], alarms["n"], alarms["value"]) == (2, 4, 0.5)
    assert alarms["met"] is False
    assert (alarms["low"], alarms["high"]) == wilson(2, 4)
    false = line(table, "outside the catalogue", "falsely flagged: all without it")
    assert (false["hits"], false["n"]) == (1, 3)
    assert line(table, "the run", "trials broken off")["hits"] == 1


def single(seed, said, gap=10.0, **more):
    item = {"name": "contact-impedance", "electrodes": [7], "parameters": {"ratio": [2.0]}}
    gaps = [[("electrode-width", 2.0), ("contact-drift", gap)]]
    return row("single:contact-impedance", seed, said, [item], gaps, ["sparse"], **more)


def test_single_effects_are_held_against_name_site_and_value():
    near = {"electrodes": [7], "ratio": (2.0, 1.9, 2.1)}
    right = found("contact-impedance", ["electrode-width"], **near)
    rows = [
        single(1, [right]),
        single(2, [found("electrode-width", ["contact-impedance"], electrodes=[7])]),
        single(3, [found("contact-impedance", electrodes=[6], ratio=(2.5, 2.4, 2.6))]),
        single(4, [right, found("offset")]),
        single(5, []),
        single(6, [found("contact-impedance", electrodes=[7], ratio=(2.5, 2.4, 2.6))]),
        single(7, [right], gap=4.0),
        single(8, [right], gap=7.9),
    ]
    table = score.diagnoses_summary(rows)

    def counts(what):
        one = line(table, "one effect", what)
        return one["hits"], one["n"]

    assert counts("right name or declared class, gap ≥ 8") == (4, 6)
    assert counts("right name or declared class, gap 5 to 8") == (1, 1)
    assert counts("right name or declared class, gap 3 to 5") == (1, 1)
    at = "right electrode, drive, measuring pair or channels"
    assert counts(f"{at}, gap ≥ 8") == (4, 6)
    assert counts(f"{at}, of those rightly named") == (3, 4)
    assert counts("class declared in full, of several") == (2, 4)
    coverage = line(table, "one effect", "90 % intervals that hold the truth, gap ≥ 8")
    assert (coverage["value"], coverage["n"]) == (0.5, 2)

    made = measures.effects(rows)
    (name,) = measures.by_name(made).to_dict("records")
    expected = {"name": "contact-impedance", "alone": 8, "alone_right": 6, "apart": 6}
    assert {**name, **expected, "apart_right": 4, "sited": 6, "sites_right": 4} == name
    assert (name["intervals"], name["covered"], name["in_sets"]) == (2, 1, 0)
    confused = measures.confusion(made).set_index("called")
    assert confused["recordings"].to_dict() == {"contact-impedance": 6, "nothing": 1, "several": 1}
    assert confused["apart"].to_dict() == {"contact-impedance": 4, "nothing": 1, "several": 1}


def test_sets_are_scored_by_f1():
    a, b = {"name": "crosstalk"}, {"name": "force-lag"}
    far, near = [("offset", 9.0)], [("offset", 5.0)]
    rows = [
        row("pair", 1, [found("crosstalk"), found("force-lag")], [a, b], [far, far]),
        row(
            "pair",
            2,
            [found("crosstalk"), found("offset"), found("drive-gain")],
            [a, b],
            [far, far],
        ),
        row("pair", 3, [], [a, b], [far, near]),
    ]
    table = score.diagnoses_summary(rows)
    gated = line(table, "two effects", "F1 of the set, each gap ≥ 8 given the others")
    assert gated["value"] == pytest.approx(2 * 3 / (4 + 5))
    assert (gated["n"], gated["met"]) == (2, False)
    every = line(table, "two effects", "F1 of the set, all")
    assert every["value"] == pytest.approx(2 * 3 / (6 + 5))
    whole = line(table, "two effects", "the whole set right, all")
    assert (whole["hits"], whole["n"]) == (1, 3)


def test_physics_outside_the_catalogue_counts_where_the_fit_leaves_some():
    law = {"law": "palm"}
    rows = [
        row("outside:palm", 1, probability=0.9, outside=law, snr_left=20.0),
        row("outside:palm", 2, probability=0.3, outside=law, snr_left=8.0),
        row("outside:palm", 3, probability=0.9, outside=law, snr_left=7.0),
        row("null", 1, probability=0.3),
        row("null", 2, probability=0.1),
    ]
    table = score.diagnoses_summary(rows)
    flagged = line(table, "outside the catalogue", "flagged, SNR ≥ 8 after the best fit")
    assert (flagged["hits"], flagged["n"]) == (1, 2)
    every = line(table, "outside the catalogue", "flagged, everything drawn")
    assert (every["hits"], every["n"]) == (2, 3)
    what = "AUROC of other.probability, SNR ≥ 8 after the best fit"
    area = line(table, "outside the catalogue", what)
    assert (area["value"], area["n"]) == (pytest.approx(3.5 / 4), 4)
    bins = measures.reliability(rows).set_index("from")
    assert bins.loc[0.3, ["n", "probability", "share"]].tolist() == [2, 0.3, 0.5]
    assert bins.loc[0.9, ["n", "probability", "share"]].tolist() == [2, 0.9, 1.0]
    assert bins["n"].sum() == 5
    off = line(table, "outside the catalogue", "other.probability: expected calibration error")
    gaps = (bins["n"] * (bins["probability"] - bins["share"]).abs()).sum()
    assert off["value"] == pytest.approx(gaps / 5) and off["wanted"] == "≤ 0.05"


def test_names_of_the_catalogue_beside_physics_that_has_none_are_counted():
    law, said = {"law": "palm"}, [{"name": "relaxation", "certain": True}]
    doubted = [{"name": "relaxation", "certain": False}]
    rows = [
        row("outside:palm", 1, said, probability=0.9, outside=law),
        row("outside:palm", 2, doubted, outside=law),
        row("outside:palm", 3, outside=law),
        row("null", 1, said),
    ]
    table = score.diagnoses_summary(rows)
    for what, hits in (("a name", 2), ("a certain name", 1)):
        counted = line(table, "outside the catalogue", f"{what} of the catalogue all the same")
        assert (counted["hits"], counted["n"]) == (hits, 3)
    constant = line(
        table, "outside the catalogue", "the same of the prevalence, said of every recording"
    )
    assert constant["value"] == 0.0
    ratio = line(
        table, "outside the catalogue", "other.probability: Brier score over that of the prevalence"
    )
    errors = np.array([0.1, 0.9, 0.9, 0.1])
    assert ratio["value"] == pytest.approx((errors**2).mean() / (0.75 * 0.25))


def test_a_probability_that_is_one_has_slope_one():
    rng = np.random.default_rng(1)
    said = rng.uniform(0.05, 0.95, 600)
    there = rng.uniform(size=600) < said
    rows = [
        row("null", i, [], outside={"law": "x"} if hit else None) for i, hit in enumerate(there)
    ]
    for one, probability in zip(rows, said, strict=True):
        one["said"]["other"]["probability"] = float(probability)
    slope = line(score.diagnoses_summary(rows), "outside the catalogue", "other.probability: slope")
    assert slope["low"] < 1.0 < slope["high"] and slope["value"] == pytest.approx(1.0, abs=0.2)


def test_hidden_frames_against_the_better_black_box():
    item = {"name": "crosstalk"}
    rows = [row("single:crosstalk", i, [], [item], [[]]) for i in (1, 2, 3)]
    rows[2] = {
        **rows[2],
        "hidden": {**HIDDEN, "rmse_V": 3.2, "chi2_per_dof": 2.0, "within_90": 0.3},
    }
    table = score.diagnoses_summary(
        [*rows, row("null", 1, hidden={**HIDDEN, "chi2_per_dof": 50.0})]
    )
    of = "hidden frames, an effect"
    what = "RMSE over that of the better black box (GP, MLP), median"
    assert line(table, of, what)["value"] == 0.25
    assert line(table, of, what)["met"] is True
    assert line(table, of, "χ²/dof, median")["value"] == 1.1
    assert line(table, of, "χ²/dof, median")["n"] == 3
    within = line(table, of, "noise-free values within the 90 % bands, mean")
    assert (within["value"], within["met"]) == (pytest.approx(0.7), False)
    assert line(table, of, "misfit closed, median")["value"] == pytest.approx(0.9)
    assert line(table, "the run", "seconds a diagnosis, worst")["value"] == 30.0


def test_a_part_of_a_block_is_scored_and_says_so(tmp_path):
    for kind, seed in trials("development", "quick")[:12]:
        one = row(kind, seed)
        if kind.startswith("single"):
            name = kind.partition(":")[2]
            one = row(kind, seed, [found(name)], [{"name": name}], [[("offset", 9.0)]])
        if not kind.startswith(("pair", "triple")):
            path = file_of(tmp_path / "trials", kind, seed)
            path.parent.mkdir(exist_ok=True)
            path.write_text(json.dumps(one))
    score.write(tmp_path, "development", "quick")
    figures.write(tmp_path, ["confusion", "other_calibration"])
    names = {path.name for path in tmp_path.iterdir() if path.is_file()}
    drawn = {f"{n}.{s}" for n in ("confusion", "other_calibration") for s in ("svg", "png", "csv")}
    tables = {"summary.csv", "summary.md", "effects.csv", "rig.csv", "rig_sizes.csv"}
    assert names == drawn | tables
    text = (tmp_path / "summary.md").read_text()
    there = len(list((tmp_path / "trials").iterdir()))
    whole = len(trials("development", "quick"))
    assert f"{there} of {whole} recordings" in text
    assert "snakemake --cores 2 calibrate_diagnosis" in text
    assert "names never drawn: none." in text


def test_false_alarms_are_told_by_what_the_rig_had():
    rows = [row("null", seed) | {"rig": [{"kind": "spikes", "size": 1e-3}]} for seed in range(4)]
    rows[0]["rig"].append({"kind": "gain-walk", "size": 1e-3})
    rows[0]["said"]["effects"] = [found("offset")]
    rows.append({"kind": "null", "seed": 9, "failed": "why"})
    rows.append(row("null", 10))
    table = score.by_rig(rows).set_index("rig_error")
    assert table["n"].to_dict() == {"any": 5, "gain-walk": 1, "spikes": 4}
    assert table["named"].to_dict() == {"any": 2, "gain-walk": 1, "spikes": 1}
    assert table["flagged"].to_dict() == {"any": 1, "gain-walk": 0, "spikes": 0}
    assert table.loc["any", "named_low"] == pytest.approx(wilson(2, 5)[0])


def test_sizes_of_rig_errors_that_can_be_told_are_counted():
    def size(told, within):
        values = ("spikes", 1.0, 1.0, 1.0, 0.9, 1.1, 0.1, told, within)
        return dict(zip(rig_sizes.ROW, values, strict=True))

    rows = [row("null", i, rig_sizes=[size(True, True)] * 2) for i in range(5)]
    rows.append(row("pair", 1, rig_sizes=[size(True, False), size(False, False)]))
    rows.append({"kind": "null", "seed": 9, "failed": "why"})
    what = "size within a factor 1.5, of those that can be told"
    counted = line(score.diagnoses_summary(rows), "errors of the rig", what)
    assert (counted["hits"], counted["n"], counted["met"]) == (10, 11, True)
    assert counted["wanted"] == "≥ 0.9"


def test_what_is_asked_for():
    table = score.diagnoses_summary([])
    asked_for = table[table["wanted"] != ""].set_index(["of", "what"])["wanted"]
    at = "right electrode, drive, measuring pair or channels, gap ≥ 8"
    within = "size within a factor 1.5, of those that can be told"
    expected = {
        ("nothing left out", "an effect named"): "≤ 0.02",
        ("nothing left out", "something outside the catalogue flagged"): "≤ 0.03",
        ("one effect", "right name or declared class, gap ≥ 8"): "≥ 0.93",
        ("one effect", at): "≥ 0.95",
        ("one effect", "90 % intervals that hold the truth, gap ≥ 8"): "0.85 to 0.95",
        ("two effects", "F1 of the set, each gap ≥ 8 given the others"): "≥ 0.9",
        ("errors of the rig", within): "≥ 0.9",
    }
    assert expected.items() <= asked_for.to_dict().items()


def test_nothing_to_score_is_no_success():
    table = score.diagnoses_summary([])
    assert (table["n"] == 0).all()
    assert table["met"].isna().all()


def skin(seed, p_values, rig="white-noise"):
    made = [{"rig": rig, "number": i, "p_value": p} for i, p in enumerate(p_values)]
    return {
        "kind": "skin",
        "seed": seed,
        "code": "a",
        "nulls": [{**m, "cpu_seconds": 1.0} for m in made],
    }


def test_small_p_values_are_counted_by_rig_and_skin_by_skin(tmp_path):
    rows = [skin(1, [0.2, 0.04, 0.005, 0.9]), skin(2, [0.3, 0.5], "gain-walk")]
    rows[1]["nulls"].append({"rig": "gain-walk", "number": 2, "failed": "why", "cpu_seconds": 4.0})
    rows.append({"kind": "skin", "seed": 3, "code": "a", "failed": "why"})
    table = p_value_score.p_value_summary(rows)
    every = line(table, "every rig", "best candidate's p below 0.05")
    assert (every["hits"], every["n"], every["met"]) == (3, 7, False)
    assert (every["low"], every["high"]) == wilson(3, 7)
    assert every["wanted"] == "≤ 0.075"
    assert line(table, "every rig", "best candidate's p below 0.01")["hits"] == 2
    drawn = line(table, "every rig", "best candidate's p below 0.05, skins drawn anew")
    assert (drawn["low"], drawn["high"], drawn["n"]) == (pytest.approx(1 / 3), 0.5, 2)
    assert line(table, "white-noise", "best candidate's p below 0.01")["hits"] == 1
    assert line(table, "gain-walk", "best candidate's p below 0.01")["value"] == pytest.approx(
        1 / 3
    )
    assert line(table, "force", "best candidate's p below 0.05")["n"] == 0
    assert line(table, "the run", "skins broken off")["hits"] == 1
    for one in rows:
        path = file_of(tmp_path / "trials", "skin", one["seed"])
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(one))
    score.write(tmp_path, "p-values-development", "full")
    names = {path.name for path in tmp_path.iterdir() if path.is_file()}
    assert names == {"summary.csv", "summary.md", "p_values.csv"}
    text = (tmp_path / "summary.md").read_text()
    assert "3 of 40 skins" in text and "7 recordings of these skins" in text


def test_no_p_values_are_no_success():
    table = p_value_score.p_value_summary([])
    assert (table["n"] == 0).all()
    assert table["met"].isna().all()


def test_a_table_of_claims_is_read_as_it_says():
    table = """
    a
      one | pair, x 3 to 5 | share y | ≥ 0.5 | 0.25 to 1 | top
      two | all | mean z | | ≤ 2
    """
    words = Words(
        {"pair": lambda row: row["n"] == 2, "y": lambda row: row["y"]},
        numbers={"z": lambda row: row["x"]},
        ceilings={"top": len},
        bands={"x": lambda low, high: lambda row: low <= row["x"] < high},
    )
    first, second = words.claims(table)
    rows = [{"n": 2, "x": 3.0, "y": True}, {"n": 2, "x": 5.0, "y": True}, {"n": 1, "x": 4.0}]
    assert first.select(rows) == rows[:1] and second.select(rows) == rows
    assert (first.gate, first.target, first.ceiling) == ((0.5, math.inf), (0.25, 1.0), len)
    assert first.measure(rows[:2])["value"] == 1.0 and second.measure(rows)["value"] == 4.0
    assert (second.subject, second.gate, second.target) == ("a", None, (-math.inf, 2.0))
    with pytest.raises(KeyError, match="nobody"):
        words.claims("a\n  one | nobody | share y")
