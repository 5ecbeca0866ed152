"""Touched places of skins with an outline: lattices, continuous places and imitated presses."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from eitskin.data.recording import Recording, metadata_of
from eitskin.errors import InputError
from eitskin.limit import posterior_mean
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate import layout, sets, state_priors, twin
from eitskin.simulate.imitation import PressPrior, imitated_presses

ELECTRODES = [[-30.0, -25.0], [30.0, -25.0], [50.0, 0.0], [30.0, 25.0], [-30.0, 25.0], [-50.0, 0.0]]
RECTANGLE = {
    "radius_mm": None,
    "thickness_mm": 3.0,
    "conductivity_S_per_m": 0.5,
    "electrode_deg": None,
    "electrode_width_mm": 0.0,
    "contact_impedivity_ohm_m2": 0.0,
    "current_A": 1e-3,
    "contrast_per_N": 0.9,
    "outline": {"shape": "rectangle", "width_mm": 100.0, "height_mm": 50.0},
    "electrode_xy_mm": ELECTRODES,
}
DISC = {key: RECTANGLE[key] for key in RECTANGLE if key not in ("outline", "electrode_xy_mm")}
DISC |= {"radius_mm": 80.0, "electrode_deg": [60.0 * k for k in range(6)]}
POLAR = {"radii": 2, "angles": 3, "inner": 0.1, "outer": 0.8}
LATTICE = {"spacing_mm": 20.0, "margin_mm": 10.0}
FORCES = {"mean_N": 5.0, "sd_N": 2.0, "max_N": 10.0}


def skin(**values):
    return Skin.from_metadata(RECTANGLE | values)


def test_a_lattice_fills_a_rectangle_up_to_the_margin():
    grid = layout.touch_grid(skin(), 16.0, **LATTICE)
    assert sorted(grid["x_mm"].unique()) == [-40.0, -20.0, 0.0, 20.0, 40.0]
    assert sorted(grid["y_mm"].unique()) == [-10.0, 10.0]
    assert (grid["place"] == np.arange(10)).all() and (grid["radius_mm"] == 8.0).all()
    assert len(layout.touch_grid(skin(), 0.0, spacing_mm=0.1, margin_mm=24.95)) == 502 * 2


@pytest.mark.parametrize(
    "outline",
    [
        {"shape": "ellipse", "width_mm": 120.0, "height_mm": 60.0},
        {"corners_mm": [[0, 0], [90, 0], [90, 30], [30, 30], [30, 90], [0, 90]]},
    ],
)
def test_places_keep_their_distance_from_any_rim(outline):
    shape = skin(outline=outline).outline
    grid = layout.touch_grid(skin(outline=outline), 0.0, spacing_mm=2.0, margin_mm=7.0)
    place = grid["x_mm"].to_numpy() + 1j * grid["y_mm"].to_numpy()
    assert (shape.depth(place) > 7.0 - 1e-6).all()
    inner = shape.lattice(4000)
    expected = (shape.depth(inner) > 7.0).sum() * shape.area_mm2 / 4000 / 4.0
    assert len(grid) == pytest.approx(expected, rel=0.2)
    drawn = state_priors.place_within(np.random.default_rng(1), 1000, shape, 7.0)
    drawn = drawn[:, 0] + 1j * drawn[:, 1]
    assert (shape.depth(drawn) > 7.0).all()
    centre = inner[shape.depth(inner) > 7.0].mean()
    assert abs(drawn.mean() - centre) < 2.0


def test_a_disc_has_the_polar_grid():
    grid = layout.touch_grid(Skin.from_metadata(DISC), 16.0, **POLAR)
    pd.testing.assert_frame_equal(grid, layout.polar_grid(80.0, probe_mm=16.0, **POLAR))


@pytest.mark.parametrize(
    ("stated", "keys", "message"),
    [
        (RECTANGLE, POLAR, "touch_grid: found no spacing_mm, expected a lattice, spacing_mm and"),
        (RECTANGLE, POLAR | LATTICE, "touch_grid.radii: found 2, expected a lattice"),
        (DISC, LATTICE, "touch_grid: found no radii, expected a polar grid, radii, angles, inner"),
        (DISC, POLAR | LATTICE, r"touch_grid.spacing_mm: found 20.0, expected a polar grid"),
        (RECTANGLE, {"spacing_mm": 9.0, "margin_mm": 26.0}, "margin_mm: found 26.0, expected a ma"),
        (RECTANGLE, {"spacing_mm": 1e-3, "margin_mm": 9.0}, "spacing_mm: found 0.001, expected 0."),
    ],
)
def test_a_grid_of_the_other_form_and_an_empty_one_are_refused(stated, keys, message):
    with pytest.raises(InputError, match=message):
        layout.touch_grid(Skin.from_metadata(stated), 0.0, **keys)


def test_no_place_is_drawn_where_there_is_no_room():
    with pytest.raises(InputError, match=r"found no place 24\.999 mm within, expected a margin"):
        state_priors.place_within(np.random.default_rng(1), 9, skin().outline, 24.999)


@pytest.fixture(scope="module")
def laid(tmp_path_factory):
    folder = tmp_path_factory.mktemp("laid")
    files = folder / "mesh.npz", folder / "grid.csv"
    forces = FORCES | {"levels": 3, "decimals": 2}
    grid = LATTICE | {"probe_mm": 16.0}
    layout.write(*files, layout.Layout(1, RECTANGLE, {"drive": "adjacent"}, grid, forces, "train"))
    return files


@pytest.mark.parametrize("is_continuous", [False, True])
def test_a_set_is_simulated_within_the_outline(laid, tmp_path, is_continuous):
    continuous = {"reach_mm": None, "margin_mm": 10.0, "probe_mm": 16.0, "forces": FORCES}
    stage = sets.SkinStage(1, RECTANGLE, "train", [], 10, False, continuous)
    stage = stage if is_continuous else replace(stage, continuous=None)
    sets.write_skin_stage(*laid, tmp_path / "stage.parquet", stage)
    sets.write_dataset(
        tmp_path / "stage.parquet", tmp_path / "set.parquet", "few", 1, 0.0, "paired"
    )
    written = sets.dataset.read(tmp_path / "set.parquet")
    assert written.delta_V.shape == (30, 6 * 3)
    is_changed = np.abs(written.delta_V).max(axis=1) > 0.0
    np.testing.assert_array_equal(is_changed, written.table["force_N"] > 0.0)
    x, y = written.table["x_mm"], written.table["y_mm"]
    assert x.abs().max() <= 40.0 and y.abs().max() <= 15.0
    assert len(np.unique(x)) == (30 if is_continuous else 5)


def test_the_limit_of_an_outline_is_refused():
    continuous = {"reach_mm": None, "margin_mm": 10.0, "probe_mm": 16.0, "forces": FORCES}
    with pytest.raises(
        InputError, match=r"skin\.outline: found an outline, expected a disc: the li"
    ):
        posterior_mean.experiment_of(None, RECTANGLE, "train", [], 10, continuous)


def test_a_twin_is_pressed_and_imitated_within_its_outline(tmp_path):
    press = {"probes_mm": [10.0], "sessions_per_probe": 1, "step_mm": 2.0, "settle_s": 1.0}
    press |= {"travel_s": 2.0, "untouched_frames": 1, "target_N": [4.0, 5.0], "frame_s": 0.1}
    press["stiffness"] = {"N_per_mm": 0.5, "exponent": 1.5, "scatter": 0.1}
    twin.write(
        tmp_path / "twin.parquet",
        twin.Twin(1, RECTANGLE, {"drive": "adjacent"}, LATTICE, press, [], 1e-3, "train"),
    )
    recorded = twin.recording.read(tmp_path / "twin.parquet")
    assert recorded.skin.outline == skin().outline
    touched = recorded.frames[recorded.frames["touch"]]
    assert len(touched[["x_mm", "y_mm"]].drop_duplicates()) == 10
    prior, rng = PressPrior(FORCES, 8.0), np.random.default_rng(2)
    states = imitated_presses(recorded, 20, rng, prior)
    place = states[states["touch"]][["x_mm", "y_mm"]].to_numpy() @ np.array([1.0, 1.0j])
    depth_mm = skin().outline.depth(place)
    assert depth_mm.min() == pytest.approx(10.0, abs=0.5) and len(np.unique(place)) == 200


def test_a_recording_of_an_outline_states_it():
    metadata = metadata_of(channel_table(6), skin().metadata(), "simulation", "signed")
    frames = pd.DataFrame({"frame": [0]})
    assert Recording(frames, None, None, None, metadata).skin == skin()
