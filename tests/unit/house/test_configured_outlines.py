"""The configuration of a skin with an outline: laid over that of a disc, or refused in one line."""

import copy
from pathlib import Path

import pytest
import yaml

from eitskin.configuration import canonical, validate, with_continuous
from eitskin.errors import InputError
from eitskin.pins import ROOT

SCHEMA = ROOT / "workflow" / "schemas" / "config.schema.yaml"
RECTANGLE = ROOT / "workflow" / "config" / "rectangle.yaml"
DISC = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
OUTLINED = yaml.safe_load(RECTANGLE.read_text(encoding="utf-8"))
FILES = (ROOT / "config.yaml", Path("mine.yaml"))


def laid_over(below: dict, above: dict) -> dict:
    """One mapping over another, key by key, as Snakemake merges files."""
    merged = copy.deepcopy(below)
    for key, value in above.items():
        is_mapping = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = laid_over(merged[key], value) if is_mapping else copy.deepcopy(value)
    return merged


@pytest.fixture
def configured(tmp_path, monkeypatch):
    """Checks the defaults with a file of one's own over them, and gives what is left of both."""
    monkeypatch.chdir(tmp_path)

    def checked(stated: dict) -> dict:
        Path("mine.yaml").write_text(yaml.safe_dump(stated), encoding="utf-8")
        config = laid_over(DISC, stated)
        validate(config, SCHEMA, FILES)
        return config

    return checked


def changed(*path_and_value):
    """The rectangle's file with one value changed, or left out where the value is None."""
    *path, last, value = path_and_value
    stated = copy.deepcopy(OUTLINED)
    block = stated
    for key in path:
        block = block[key]
    block[last] = value
    if value is None:
        del block[last]
    return stated


def test_the_discs_radius_angles_and_polar_grid_are_left_out(configured):
    config = configured(OUTLINED)
    for block in (config, config["twin"]):
        assert block["skin"]["radius_mm"] is None and block["skin"]["electrode_deg"] is None
        assert set(block["touch_grid"]) - {"probe_mm"} == {"spacing_mm", "margin_mm"}
    assert canonical(config, SCHEMA)["skin"]["outline"]["width_mm"] == 150.0
    continuous = with_continuous(config)["authors-continuous"]["continuous"]
    assert (continuous["reach_mm"], continuous["margin_mm"]) == (None, 9.0)


def test_a_disc_keeps_all_that_it_states(configured):
    config = configured({})
    assert config == DISC
    assert "margin_mm" not in with_continuous(config)["authors-continuous"]["continuous"]


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        (
            {"touch_grid": {"spacing_mm": 9.0, "margin_mm": 5.0}},
            "mine.yaml: touch_grid.spacing_mm: found 9.0, expected a polar grid, radii, angles, "
            "inner and outer, as the skin is a disc",
        ),
        (
            changed("touch_grid", "spacing_mm", None),
            "mine.yaml: touch_grid: found no spacing_mm, expected a lattice, spacing_mm and "
            "margin_mm, as the skin has an outline",
        ),
        (
            changed("twin", "touch_grid", "radii", 3),
            "mine.yaml: twin.touch_grid.radii: found 3, expected a lattice",
        ),
        (
            changed("touch_grid", "margin_mm", 35.5),
            "mine.yaml: touch_grid.margin_mm: found 35.5, expected a margin within which",
        ),
        (
            changed("skin", "radius_mm", 70.0),
            "mine.yaml: skin.radius_mm: found 70 mm beside an outline",
        ),
        (
            changed("skin", "outline", "width_mm", None),
            "mine.yaml: skin.outline: found {",
        ),
        (
            changed("skin", "electrode_xy_mm", 0, [0.0, 70.0]),
            "mine.yaml: skin.electrode_xy_mm: found electrode 0 35 mm beyond the rim",
        ),
        (
            {"skin": {"radius_mm": None}},
            "mine.yaml: skin.radius_mm: found null, expected a value, or an outline of the skin",
        ),
    ],
)
def test_what_does_not_fit_the_skin_is_refused_by_file_and_key(configured, stated, message):
    with pytest.raises(InputError) as refusal:
        configured(stated)
    assert str(refusal.value).startswith(message)
