from itertools import combinations

import pytest

from eitskin.errors import InputError
from eitskin.paper import figure_2
from eitskin.paper.figure_2 import Layout, Rules
from eitskin.pins import ROOT

DOT = """digraph snakemake_dag {
    node[shape=box];
	0[label = "all", color = "0.00 0.6 0.85", style="rounded"];
	1[label = "mesh", color = "0.07 0.6 0.85", style="rounded,dashed"];
	2[label = "perturb", color = "0.07 0.6 0.85"];
	3[label = "split", color = "0.07 0.6 0.85"];
	1 -> 2
	2 -> 2
	2 -> 3
	1 -> 3
	3 -> 0
}
"""
STAGE = {"mesh": "simulate", "perturb": "perturb", "split": "dataset", "unused": "dataset"}


def test_snakemake_s_graph_is_read():
    rules = figure_2.parse(DOT, STAGE)
    assert rules.edges == [("mesh", "perturb"), ("mesh", "split"), ("perturb", "split")]
    assert rules.stage == {"mesh": "simulate", "perturb": "perturb", "split": "dataset"}
    assert rules.repeated == {"perturb"}


def test_a_graph_without_rules_in_turn_is_refused():
    with pytest.raises(InputError, match="no two rules in turn"):
        figure_2.parse(DOT, {"mesh": "simulate"})


def test_an_edge_that_follows_from_others_is_in_the_table_but_not_drawn():
    table = figure_2.table(figure_2.parse(DOT, STAGE)).set_index(["before", "after"])["drawn"]
    assert not table["mesh", "split"]
    assert table["mesh", "perturb"] and table["perturb", "split"]


def test_columns_follow_the_longest_way_and_what_needs_one_another_shares_one():
    edges = [("a", "b"), ("b", "c"), ("a", "c"), ("c", "d"), ("d", "c2")]
    stage = {"a": "first", "b": "second", "c": "third", "c2": "third", "d": "back"}
    assert figure_2.columns(Rules(edges, stage)) == {
        "first": 0,
        "second": 1,
        "third": 2,
        "back": 2,
    }


@pytest.fixture
def house():
    """A graph with ways past columns, of the size of the workflow's."""
    stage = {f"{s}{k}": s for s in "abcdef" for k in range(3)}
    edges = [(f"{s}{k}", f"{t}{k}") for s, t in zip("abcde", "bcdef", strict=True) for k in (0, 1)]
    edges += [("a0", "a1"), ("a1", "a2"), ("a2", "f2"), ("b2", "e2"), ("c2", "f1"), ("a2", "d2")]
    return Rules(edges, stage)


def test_no_boxes_overlap_and_all_lie_within_their_stage(house):
    layout = Layout(house)
    half = 0.5 * layout.width
    for (_, (xa, ya)), (_, (xb, yb)) in combinations(layout.box.items(), 2):
        assert abs(xa - xb) >= 2 * half or abs(ya - yb) >= figure_2.BOX
    for rule, (x, y) in layout.box.items():
        left_edge, top, width, height = layout.frame[house.stage[rule]]
        assert left_edge <= x - half and x + half <= left_edge + width
        assert top <= y - 0.5 * figure_2.BOX and y + 0.5 * figure_2.BOX <= top + height
    assert max(x + w for x, _, w, _ in layout.frame.values()) <= 180.0
    assert min(y for _, y, _, _ in layout.frame.values()) >= 0.0


def test_arrows_that_pass_a_column_pass_its_stages(house):
    layout = Layout(house)
    passed = 0
    for edge in layout.drawn:
        if layout._column_of(edge[0]) == layout._column_of(edge[1]):
            continue
        way = layout.waypoints(edge)
        assert way[0][0] < way[-1][0]
        for x, y in way[1:-1]:
            passed += 1
            for left_edge, top, width, height in layout.frame.values():
                assert not (left_edge <= x <= left_edge + width and top < y < top + height)
    assert passed


def test_every_rule_of_the_workflow_has_a_stage():
    files = sorted((ROOT / "workflow" / "rules").glob("*.smk"))
    stage = figure_2.stages(files)
    assert stage["mesh"] == "simulate" and stage["perturb"] == "perturb"
    assert stage["train_predictor"] == "train" and stage["evaluate"] == "evaluate"
    assert stage["diagnose_with_query"] == "diagnose" and stage["figure_2"] == "figures"


def test_long_names_are_broken_at_an_underscore():
    assert figure_2._wrapped("train_autoencoder") == "train_\nautoencoder"
    assert figure_2._wrapped("figure_1") == "figure_1"


def test_it_is_drawn_with_every_rule_in_it(house, tmp_path):
    figure = figure_2.draw(house)
    texts = {text.get_text() for text in figure.axes[0].texts}
    assert set(house.stage) <= texts and set("abcdef") <= texts
