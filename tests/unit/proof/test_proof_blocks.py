"""Which recordings a calibration is made of."""

from collections import Counter

import pytest

from eitskin.errors import InputError
from proof import drawing, trial
from proof.blocks import (
    ALIEN_SIZES,
    CONTROL_SIZES,
    FIRST_SEED,
    OUTLINE_SIZES,
    OWNER_SIZES,
    P_VALUE_SIZES,
    QUERY_SIZES,
    SIZES,
    batches,
    case_batches,
    case_names,
    sort_of,
    tables,
    trials,
)
from witness import controls, owned
from witness.cases import ON_OUTLINES, names_of
from witness.generators import GENERATORS
from witness.outside import OUTSIDE
from witness.strengths import DRAWN

WHOLE = {
    "quick": {"null": 60, "pair": 24, "triple": 16, "outside": 36},
    "full": {"null": 150, "pair": 60, "triple": 40, "outside": 60},
}


@pytest.mark.parametrize("size", SIZES)
def test_a_plan_has_the_numbers_stated(size):
    plan = trials("report", size)
    assert len(set(plan)) == len(plan)
    words = Counter(kind.partition(":")[0] for kind, _ in plan)
    assert words == {**WHOLE[size], "single": 4 * len(DRAWN)}
    each = Counter(kind for kind, _ in plan if kind.startswith("single:"))
    assert set(each.values()) == {4}
    laws = Counter(kind for kind, _ in plan if kind.startswith("outside:"))
    assert len(laws) == len(OUTSIDE)
    assert max(laws.values()) - min(laws.values()) <= 1


def test_blocks_share_no_seed_and_sizes_are_nested():
    tuned, told = trials("development", "full"), trials("report", "full")
    assert not {seed for _, seed in tuned} & {seed for _, seed in told}
    assert set(trials("report", "quick")) <= set(told)
    assert [kind for kind, _ in tuned] == [kind for kind, _ in told]


@pytest.mark.parametrize("size", SIZES)
def test_ordinary_rigs_record_the_same_skins(size):
    plan = trials("ordinary-report", size)
    assert all(kind.endswith("+rig") for kind, _ in plan)
    bare = {(kind.removesuffix("+rig"), seed) for kind, seed in plan}
    words = Counter(kind.partition(":")[0] for kind, _ in bare)
    assert (
        words
        == {
            "quick": {"null": 100, "single": len(DRAWN), "pair": 12, "outside": 18},
            "full": {"null": 300, "single": 4 * len(DRAWN), "pair": 40, "outside": 54},
        }[size]
    )
    laws = Counter(kind for kind, _ in bare if kind.startswith("outside:"))
    assert len(laws) == len(OUTSIDE) and len(set(laws.values())) == 1
    shared = bare & set(trials("report", size))
    assert len(shared) >= min(len(bare), len(trials("report", size))) / 3
    tuned = trials("ordinary-development", size)
    assert not {seed for _, seed in tuned} & {seed for _, seed in plan}


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(
    ("block", "word"),
    [("alien-development", "alien"), ("alien-report", "alien"), ("alien-sealed", "sealed")],
)
def test_rigs_with_errors_in_other_forms(block, word, size):
    plan = trials(block, size)
    assert len(set(plan)) == len(plan) and {kind.partition("+")[2] for kind, _ in plan} == {word}
    words = Counter(kind.partition("+")[0].partition(":")[0] for kind, _ in plan)
    number = {**ALIEN_SIZES[size], "single": ALIEN_SIZES[size]["single"] * len(DRAWN)}
    assert words == {kind: n for kind, n in number.items() if n}
    seeds = [
        {s for _, s in trials(f"alien-{one}", size)} for one in ("development", "report", "sealed")
    ]
    assert not (seeds[0] & seeds[1] or seeds[0] & seeds[2] or seeds[1] & seeds[2])


def test_every_third_recording_in_other_forms_has_another_solver(monkeypatch):
    plan = trials("alien-report", "full")
    made = {(kind, seed): drawing.generator(kind, seed) for kind, seed in plan}
    for word in ("null", "pair", "single", "outside"):
        chosen = [name for (kind, _), name in made.items() if kind.startswith(word)]
        assert {*GENERATORS} == {*chosen}
        assert 0.5 < chosen.count("boundary") / len(chosen) < 0.8
    for (kind, _), name in made.items():
        assert GENERATORS[name].can(kind.partition("+")[0])
    assert {drawing.generator(*trial) for trial in trials("ordinary-report", "full")} == {
        "boundary"
    }
    monkeypatch.setattr(drawing.cases, "draw", lambda kind, seed, **options: options)
    kind, seed = next(trial for trial, name in made.items() if name == "disc")
    assert drawing.draw(kind, seed) == {"generator": "disc"}
    assert drawing.draw(kind, seed, generator="slab") == {"generator": "slab"}


@pytest.mark.parametrize("size", SIZES)
def test_blocks_of_p_values_are_skins(size):
    tuned, told = trials("p-values-development", size), trials("p-values-report", size)
    assert len(set(told)) == P_VALUE_SIZES[size]["skin"] and {kind for kind, _ in told} == {"skin"}
    assert not set(tuned) & set(told)
    assert [one for batch in batches("p-values-report", size) for one in batch] == told


@pytest.mark.parametrize(("size", "number"), [("quick", 20), ("full", 200)])
def test_queries_are_of_every_kind(size, number):
    plan = trials("queries-report", size)
    assert len(set(plan)) == len(plan) == number
    assert Counter(kind for kind, _ in plan) == {
        f"query:{kind}": count for kind, count in QUERY_SIZES[size].items()
    }
    assert not {s for _, s in plan} & {s for _, s in trials("queries-development", size)}
    assert {kind for kind, _ in plan[: number // 3]} == {kind for kind, _ in plan}


@pytest.mark.parametrize(("size", "number"), [("quick", 8), ("full", 40)])
def test_owners_recordings_are_of_every_kind(size, number):
    plan = trials("owners-report", size)
    assert len(set(plan)) == len(plan) == number
    assert Counter(kind for kind, _ in plan) == {
        f"owner:{kind}": count for kind, count in OWNER_SIZES[size].items()
    }
    assert set(OWNER_SIZES[size]) == set(owned.KINDS)
    assert not {s for _, s in plan} & {s for _, s in trials("owners-development", size)}


@pytest.mark.parametrize(("size", "number"), [("quick", 58), ("full", 660)])
def test_controls_are_of_every_kind_by_two_solvers_in_turn(size, number):
    plan = trials("controls-report", size)
    assert len(set(plan)) == len(plan) == number
    assert Counter(kind for kind, _ in plan) == {
        f"control:{kind}": count for kind, count in CONTROL_SIZES[size].items()
    }
    assert set(CONTROL_SIZES[size]) == set(controls.KINDS)
    assert not {s for _, s in plan} & {s for _, s in trials("controls-development", size)}
    whites = Counter(drawing.generator(*one) for one in plan if "white-" in one[0])
    assert whites == dict.fromkeys(("boundary", "disc"), whites.total() / 2)


@pytest.mark.parametrize("size", OUTLINE_SIZES)
def test_outlines_are_of_every_name_and_half_by_rigs_with_errors(size):
    plan, number = trials("outlines-report", size), OUTLINE_SIZES[size]
    assert len(set(plan)) == len(plan) == number["null"] + number["single"] * len(ON_OUTLINES)
    words = Counter(kind.partition("+")[2] for kind, _ in plan)
    assert set(words) == {"outline", "outline+rig"} and abs(words["outline"] - len(plan) / 2) <= 1
    names = Counter(kind.partition("+")[0] for kind, _ in plan)
    assert names.pop("null") == number["null"]
    assert names == {f"single:{name}": number["single"] for name in ON_OUTLINES}
    assert not {s for _, s in plan} & {s for _, s in trials("outlines-development", size)}
    assert {drawing.generator(*one) for one in plan} == {"elements"}


@pytest.mark.parametrize("block", FIRST_SEED)
def test_a_smaller_size_is_part_of_the_larger(block):
    assert set(trials(block, "quick")) <= set(trials(block, "full"))


def test_a_sort_of_block_has_tables_of_its_own():
    assert [sort_of(f"{word}report") for word in ("", "ordinary-")] == ["diagnoses"] * 2
    assert tables("report") == tables("ordinary-report") and "confusion" in tables("report")
    assert tables("alien-sealed") == tables("report")
    assert tables("p-values-report") == ("summary", "p_values")
    assert tables("queries-report") == ("summary", "queries")
    assert tables("owners-report") == ("summary", "owners")
    assert tables("controls-report") == ("summary", "controls")


@pytest.mark.parametrize(
    ("block", "how"),
    [
        ("ordinary-report", "trial"),
        ("alien-sealed", "trial"),
        ("outlines-report", "trial"),
        ("p-values-report", "skin"),
        ("queries-report", "query_trial"),
        ("owners-report", "owner_trial"),
        ("controls-report", "control_trial"),
    ],
)
def test_every_kind_is_tried_as_its_sort_is(monkeypatch, block, how):
    for name in ("trial", "skin", "query_trial", "owner_trial", "control_trial"):
        monkeypatch.setattr(trial, name, lambda kind, seed, name=name: {"how": name})
    plan = trials(block, "quick")
    head = ("kind", "seed", "how")
    rows = [tuple(trial.row(*one)[key] for key in head) for one in plan]
    assert rows == [(*one, how) for one in plan]


def test_the_witness_knows_every_kind():
    for kind in {kind for kind, _ in trials("report", "full")} - {"pair", "triple"}:
        names_of(kind, None)


def test_half_a_plan_holds_half_of_each():
    plan = trials("report", "full")
    half = Counter(kind.partition(":")[0] for kind, _ in plan[: len(plan) // 2])
    for word, number in {**WHOLE["full"], "single": 4 * len(DRAWN)}.items():
        assert abs(half[word] - number / 2) <= 2


def test_batches_are_the_plan():
    made = batches("development", "quick")
    assert [one for batch in made for one in batch] == trials("development", "quick")
    assert max(map(len, made)) == 8


@pytest.mark.parametrize(("block", "size"), [("tuning", "full"), ("report", "huge")])
def test_an_unknown_plan_is_refused(block, size):
    with pytest.raises(InputError, match=r"calibration: (block|size)"):
        trials(block, size)


def test_batches_of_cases_are_their_names():
    assert case_names(3) == ["case-001", "case-002", "case-003"]
    made = case_batches(24, 5)
    assert [name for batch in made for name in batch] == case_names(24)
    assert max(map(len, made)) == 5 and len(made) == 5
