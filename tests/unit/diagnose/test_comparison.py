"""Sessions of a skin of 8 electrodes compared: what is shared, and what changed."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from eitskin.data.recording import Recording, validate
from eitskin.diagnose.comparison.compare import (
    _discovered,
    _runs,
    _test,
    compare,
    parts,
)
from eitskin.diagnose.comparison.joint import CALIBRATED, _carried, _merged, fitted, union
from eitskin.diagnose.comparison.result import result, write
from eitskin.diagnose.diagnosis import Diagnosis, diagnose, problem_of
from eitskin.diagnose.fitting.candidates import Candidate, catalogue
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.held_out import folds
from eitskin.diagnose.noise.estimate import estimate_noise
from eitskin.diagnose.report import comparison_page
from eitskin.diagnose.search.search import Search
from eitskin.diagnose.verdict.gaps import Gap
from eitskin.effects.settings import site_counts
from eitskin.errors import InputError
from skin_sessions import CHANNELS, CONTACT, GAIN, OPEN, SKIN, recorded


def named(recording: Recording, *wanted: tuple[str, tuple[int, ...] | None, str]) -> Diagnosis:
    """A diagnosis that found the effects wanted (name, sites, scope), without a search."""
    noise = estimate_noise(recording)
    problem, scales = problem_of(recording, noise)
    counts = site_counts(CHANNELS)
    candidates = catalogue(
        SKIN, problem.model.believed, recording.voltage, counts, scales, True, True
    )
    fold = folds(problem.model.touched, problem.model.press, CHANNELS, 1)
    search = Search(problem, candidates, fold, seed=1, report=lambda line: None)
    found = [
        next(
            c
            for c in candidates
            if (c.name, c.sites, c.scope) == (name, sites, scope) and c.kind != "channels"
        )
        for name, sites, scope in wanted
    ]
    before = search.calibrated()
    start = np.r_[before.fit.theta, np.zeros(sum(c.size for c in found))]
    after = search.state(fit(problem, found, start, polish=True))
    empty = pd.DataFrame()
    return Diagnosis(
        recorded=recording,
        search=search,
        noise=noise,
        before=before,
        after=after,
        aside=np.zeros(recording.voltage.shape, bool),
        judged=None,
        rig=[],
        atlas_before=empty,
        atlas_after=empty,
        named=after.fit,
        gaps=[[] for _ in found],
        strengths={},
        other=None,
    )


def changed(compared) -> list[tuple]:
    said = result(compared)["tested"]
    return [(row["name"], row["electrodes"], row["drives"]) for row in said if row["changed"]]


def test_sessions_are_split_in_order_of_time():
    whole = recorded([[], [], []], presses=2)
    whole.frames["session"] = whole.frames["session"].map({"a": "z", "b": "m", "c": "n"})
    found = parts(whole)
    assert list(found) == ["z", "m", "n"]
    for name, part in found.items():
        rows = (whole.frames["session"] == name).to_numpy()
        assert np.array_equal(part.voltage, whole.voltage[rows])
        assert np.array_equal(part.frames["time_s"], whole.frames["time_s"][rows])
        validate(part, name)


def test_a_session_that_cannot_stand_alone_is_joined_to_the_one_before():
    whole = recorded([[], [], [], []], presses=2)
    keep = ~(whole.frames["session"].isin(["a", "c"]) & ~whole.frames["touch"]).to_numpy()
    frames = whole.frames[keep].reset_index(drop=True).assign(frame=np.arange(keep.sum()))
    whole = replace(whole, frames=frames, voltage=whole.voltage[keep])
    found = parts(whole)
    assert list(found) == ["a + b + c", "d"]
    assert sum(len(part.frames) for part in found.values()) == keep.sum()
    whole.voltage[(frames["session"] == "d").to_numpy()] = np.nan
    with pytest.raises(InputError, match=r"skin\.parquet: column session: found 4 in all, 1 that"):
        parts(whole, "skin.parquet")


def test_what_names_no_sessions_is_refused():
    whole = recorded([[], []], presses=1)
    with pytest.raises(InputError, match="column session: found nothing"):
        parts(replace(whole, frames=whole.frames.drop(columns="session")))
    whole.frames.loc[7, "session"] = None
    with pytest.raises(InputError, match="column session, row 7: found null"):
        parts(whole)


@pytest.mark.long
def test_where_nothing_changed_all_is_shared():
    wrong = 0
    for seed in range(20):
        first, second = parts(recorded([[CONTACT, GAIN]] * 2, seed)).values()
        compared = compare(
            {
                "a": named(first, ("contact-impedance", (3,), "sparse")),
                "b": named(
                    second,
                    ("contact-impedance", (3,), "sparse"),
                    ("drive-gain", (5,), "sparse"),
                    ("offset", (2,), "sparse"),
                ),
            }
        )
        assert len(compared.tested) == 4
        wrong += bool(changed(compared))
    assert wrong <= 2


@pytest.mark.long
def test_the_contact_that_changed_is_reported_and_nothing_else(tmp_path):
    whole = recorded([[], [CONTACT]])
    founds = {f"session {name}": diagnose(part) for name, part in parts(whole).items()}
    compared = compare(founds)
    assert changed(compared) == [("contact-impedance", [3], [])]
    said = result(compared)
    (sentence,) = said["sentences"]
    assert sentence.startswith("Since session b electrode 3 touches the gel through ")
    row = next(row for row in said["tested"] if row["changed"])
    before, since = (run["values"]["ratio"] for run in row["runs"])
    assert before["low"] < 1.0 < before["high"] and since["low"] < 3.0 < since["high"]
    held = said["held_out"]
    assert held["chi2_per_dof_as_found"] < 1.1
    assert held["chi2_per_dof_as_found"] < held["chi2_per_dof_all_shared"]
    assert held["elpd_gain"] > 5 * held["elpd_se"]
    write(said, tmp_path / "comparison.json")
    comparison_page.write(said, tmp_path / "comparison.html")
    assert json.loads((tmp_path / "comparison.json").read_text("utf-8")) == said
    html = (tmp_path / "comparison.html").read_text("utf-8")
    assert sentence in html and "<img src='data:image/svg+xml" in html
    assert "http" not in html
    assert " nats;" in html and "10 nats, 22000 times" in html
    again = compare(founds)
    assert json.dumps(result(again)) == json.dumps(said)


def test_a_value_that_is_shared_is_the_weighted_mean_of_the_parts():
    first, second = parts(recorded([[GAIN], [GAIN, CONTACT]])).values()
    wanted = [("drive-gain", (5,), "sparse"), ("contact-impedance", (3,), "sparse")]
    compared = compare({"a": named(first, wanted[0]), "b": named(second, *wanted)})
    said = result(compared)["tested"]
    gain = next(row for row in said if row["name"] == "drive-gain")
    (run,) = gain["runs"]
    own = [part["gain"] for part in gain["parts"].values()]
    weight = np.array([(each["high"] - each["low"]) ** -2.0 for each in own])
    together = run["values"]["gain"]
    expected = weight @ [each["value"] for each in own] / weight.sum()
    width = together["high"] - together["low"]
    assert together["value"] == pytest.approx(expected, abs=0.1 * width)
    assert width == pytest.approx(weight.sum() ** -0.5, rel=0.1)
    assert together["low"] < 1.02 < together["high"]


def test_an_electrode_that_lost_contact_did_so_since_then():
    first, second = parts(recorded([[], [OPEN]])).values()
    compared = compare({"a": named(first), "b": named(second, ("electrode-open", (3,), "sparse"))})
    assert changed(compared) == [("electrode-open", [3], [])]
    assert result(compared)["sentences"][0].startswith("Since b electrode 3 is not connected")


def test_an_electrode_open_throughout_has_not_changed():
    first, second = parts(recorded([[OPEN], [OPEN]])).values()
    always = ("electrode-open", (3,), "sparse")
    compared = compare({"a": named(first, always), "b": named(second, always)})
    assert changed(compared) == []
    texts = [test.sentence for test in compared.tested]
    assert any(text.startswith("Throughout, electrode 3 is not connected") for text in texts)


def test_an_effect_that_one_part_overlooked_is_shared():
    first, second = parts(recorded([[OPEN], [OPEN]])).values()
    compared = compare({"a": named(first), "b": named(second, ("electrode-open", (3,), "sparse"))})
    assert changed(compared) == []
    assert compared.as_found.chi2_per_dof < 1.2


def test_what_changed_and_came_back_is_told_part_by_part():
    whole = recorded([[], [CONTACT], [], []])
    wanted = {"b": [("contact-impedance", (3,), "sparse")]}
    founds = {name: named(part, *wanted.get(name, [])) for name, part in parts(whole).items()}
    compared = compare(founds)
    (row,) = [row for row in result(compared)["tested"] if row["changed"]]
    assert [run["parts"] for run in row["runs"]] == [["a"], ["b"], ["c", "d"]]
    assert row["sentence"].startswith("Since c electrode 3 ") and " in a, then " in row["sentence"]


def test_the_values_of_a_part_that_noise_alone_does_not_explain_are_worth_less():
    texture = {"name": "offset", "measures": [1], "parameters": {"volt": 3e-4}}
    first, second = parts(recorded([[texture], [GAIN, texture]])).values()
    shared = union({"b": named(second, ("drive-gain", (5,), "sparse"))})
    founds = {"a": named(first), "b": named(second, ("drive-gain", (5,), "sparse"))}
    own = fitted(founds, shared, [{"a": True, "b": True}])
    assert min(part.scale for part in own) > 2.0
    for part in own:
        assert np.allclose(part.spread, part.scale * part.fit.covariance)
    test = _test(own, 0, "gain", 5)
    values = [(p.fit.theta[1], p.spread[1, 1]) for p in own]
    expected = (values[0][0] - values[1][0]) ** 2 / (values[0][1] + values[1][1])
    assert test.chi2 == pytest.approx(expected)


def test_other_skins_and_single_parts_are_refused():
    first, second = parts(recorded([[], []], presses=2)).values()
    a, b = named(first), named(second)
    with pytest.raises(InputError, match="parts: found 1, expected two or more"):
        compare({"a": a})
    skin = {**second.metadata["skin"], "electrode_width_mm": 7.0}
    other = replace(b, recorded=replace(second, metadata={**second.metadata, "skin": skin}))
    with pytest.raises(InputError, match=r"b: key skin\.electrode_width_mm: found 7\.0, expected"):
        compare({"a": a, "b": other})


def candidates_of(recording: Recording, name: str, scope: str) -> list[Candidate]:
    problem, scales = problem_of(recording, estimate_noise(recording))
    skin, counts = problem.model.believed, site_counts(CHANNELS)
    found = catalogue(SKIN, skin, recording.voltage, counts, scales, True, True)
    return [c for c in found if (c.name, c.scope) == (name, scope)]


def test_effects_of_one_name_become_one_that_does_the_same():
    whole = recorded([[]], presses=2)
    single = candidates_of(whole, "contact-impedance", "sparse")
    (common,) = candidates_of(whole, "contact-impedance", "common")
    both = _merged(single[2], single[5])
    assert both.sites == (2, 5) and both.scope == "sparse"
    dense = _merged(single[2], common)
    assert dense.sites == tuple(range(8)) and dense.scope == "dense"
    for own, to, values in (
        (single[5], both, [0.7]),
        (single[2], dense, [0.7]),
        (common, dense, [-0.4]),
    ):
        carried, slope, _ = _carried(own, np.array(values), to)
        ratio = np.ones(8)
        ratio[list(own.sites)] = own.setting(values).values["ratio"]
        again = np.ones(8)
        again[list(to.sites)] = to.setting(carried).values["ratio"]
        assert np.allclose(ratio, again)
        assert np.isnan(slope).any() or own.sites == to.sites
    shapes = candidates_of(whole, "domain-shape", "")
    assert _merged(shapes[2], shapes[3]) is None
    opens = candidates_of(whole, "electrode-open", "sparse")
    assert _merged(opens[0], opens[1]) is None and _merged(opens[0], opens[0]) == opens[0]


def test_names_that_a_part_cannot_tell_apart_are_one_effect():
    first, second = parts(recorded([[CONTACT], [CONTACT]])).values()
    a = named(first, ("contact-impedance", (3,), "sparse"))
    b = named(second, ("electrode-width", (3,), "sparse"))
    assert len(union({"a": a, "b": b})) == 2
    b = replace(b, gaps=[[Gap("contact-impedance", 1.0, 20.0)]])
    (shared,) = union({"a": a, "b": b})
    assert shared.candidate.name == "contact-impedance" and set(shared.own) == {"a", "b"}
    assert shared.alternatives == {"electrode-width"}
    assert changed(compare({"a": a, "b": b})) == []


def test_runs_join_neighbours_that_are_alike():
    at = {
        name: (np.array([v]), np.eye(1)) for name, v in zip("abcd", (0, 0.5, 9, 9.5), strict=True)
    }
    assert _runs(at) == [("a", "b"), ("c", "d")]
    assert len(_runs({name: (np.zeros(1), np.eye(1)) for name in "abc"})) == 2


def test_a_false_discovery_is_no_change():
    first, second = parts(recorded([[], []], presses=2)).values()
    founds = {"a": named(first), "b": named(second)}
    own = fitted(founds, [], [])
    test = _test(own, CALIBRATED, "conductivity_S_per_m", None)
    chance = [replace(test, p=p) for p in (0.004, 0.3, 0.5, 0.9)]
    assert not any(t.changed for t in _discovered(chance))
    sure = _discovered([replace(test, p=1e-6), *chance])
    assert [t.changed for t in sure] == [True, False, False, False, False]
    assert sure[0].q == pytest.approx(5e-6)


def test_changes_that_the_joint_fit_does_not_need_are_none(monkeypatch):
    first, second = parts(recorded([[], []], presses=3)).values()
    wanted = ("contact-impedance", (3,), "sparse")
    founds = {"a": named(first, wanted), "b": named(second)}
    apart = [("a",), ("b",)]
    monkeypatch.setattr(
        "eitskin.diagnose.comparison.compare._discovered",
        lambda tested: [replace(test, q=1e-9, groups=apart) for test in tested],
    )
    compared = compare(founds)
    assert changed(compared) == [] and compared.p_value > 0.01
    assert "no better than noise would" in comparison_page.page(result(compared))
    second = next(iter(parts(recorded([[CONTACT], []], presses=3)).values()))
    compared = compare({"a": named(first, wanted), "b": named(second)})
    assert len(changed(compared)) == 2 and compared.p_value < 1e-6


def test_the_figure_has_a_panel_a_value():
    first, second = parts(recorded([[], [CONTACT]])).values()
    wanted = ("contact-impedance", (3,), "sparse")
    said = result(compare({"a": named(first), "b": named(second, wanted)}))
    titles = [axes.get_title() for axes in comparison_page.figure(said).axes]
    assert titles == ["contact-impedance\nelectrode 3", "calibration"]
