"""The simulated sets: grid, forces, sessions, stages, noise and baseline."""

from pathlib import Path

import numpy as np
import pytest

from eitskin.data import dataset
from eitskin.effects.effect import START
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.forward import Forward, channel_values
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.physics.touch import Touch
from eitskin.simulate import chain as links
from eitskin.simulate import layout, sets, stages
from eitskin.simulate.readings import apply_skin

CHANNELS = channel_table(16)
SKIN = {
    "radius_mm": 80.0,
    "thickness_mm": 3.0,
    "conductivity_S_per_m": 0.5,
    "electrode_deg": [22.5 * k for k in range(16)],
    "electrode_width_mm": 0.0,
    "contact_impedivity_ohm_m2": 0.0,
    "current_A": 1e-3,
    "contrast_per_N": 0.9,
}
GRID = {"radii": 2, "angles": 3, "inner": 0.1, "outer": 0.8, "probe_mm": 16.0}
FORCES = {"mean_N": 5.0, "sd_N": 2.0, "max_N": 10.0, "levels": 5, "decimals": 2}
ELLIPSE = {"name": "ellipse", "parameters": {"sx": {"sd": 0.05}, "sy": {"sd": 0.05}}}
GAIN = {"name": "force-dependent-gain", "parameters": {"per_N": 0.01, "F_mid_N": 5.0}}


def chain(folder: Path, crossed=False, baseline="paired", noise=0.01):
    laid, grid = folder / "mesh.npz", folder / "grid.csv"
    layout.write(laid, grid, layout.Layout(1, SKIN, {"drive": "adjacent"}, GRID, FORCES, "train"))
    sets.write_skin_stage(
        laid, grid, folder / "0.parquet", sets.SkinStage(1, SKIN, "train", [ELLIPSE], 12, crossed)
    )
    sets.write_stage(folder / "0.parquet", folder / "1.parquet", 1, GAIN, 1)
    out = folder / "set.parquet"
    sets.write_dataset(folder / "1.parquet", out, "authors", 1, noise, baseline)
    return out


def test_the_papers_grid():
    grid = layout.polar_grid(80.0, 8, 24, 0.1, 0.9, 16.0)
    r = np.hypot(grid.x_mm, grid.y_mm)
    assert len(grid) == 192 and len(grid.drop_duplicates()) == 192
    assert np.allclose(np.unique(np.round(r, 9)), 80 * np.linspace(0.1, 0.9, 8))
    assert (grid.radius_mm == 8.0).all()


@pytest.mark.parametrize("crossed", [False, True])
def test_as_many_cores_as_there_are_give_the_same_bytes(tmp_path, monkeypatch, crossed):
    written = []
    monkeypatch.setattr(sets, "SESSIONS", 1)
    for allowed in ("1", "2"):
        monkeypatch.setenv("OMP_NUM_THREADS", allowed)
        (tmp_path / allowed).mkdir()
        written.append(chain(tmp_path / allowed, crossed).read_bytes())
    assert written[0] == written[1]


def test_a_session_is_refused_from_any_process(tmp_path, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    chain(tmp_path)
    laid, grid, out = (tmp_path / name for name in ("mesh.npz", "grid.csv", "rough.parquet"))
    rough = {"name": "domain-shape", "parameters": {"harmonic": 3, "amplitude": 0.9}}
    with pytest.raises(InputError, match=r"found 0\.9"):
        skin_stage = sets.SkinStage(1, SKIN, "train", [rough], 12, False)
        sets.write_skin_stage(laid, grid, out, skin_stage)
    assert not out.exists()


def test_force_levels():
    levels = layout.force_levels(1, 5.0, 2.0, 10.0, 260, 2)
    assert len(np.unique(levels)) == 260 and (np.diff(levels) > 0).all()
    assert levels.min() >= 0 and levels.max() <= 10
    assert np.mean(levels) == pytest.approx(5.0, abs=0.5)
    assert np.std(levels) == pytest.approx(2.0, abs=0.5)
    assert np.array_equal(levels, layout.force_levels(1, 5.0, 2.0, 10.0, 260, 2))
    with pytest.raises(InputError, match="levels"):
        layout.force_levels(1, 5.0, 2.0, 10.0, 200, 0)


def test_sessions_in_order_and_crossed():
    session, place, level = sets.sessions(192, 260, 300, False, 1)
    assert np.bincount(session).max() == 300 and (np.diff(place) >= 0).all()
    crossed = sets.sessions(192, 260, 960, True, 1)
    for s in np.unique(crossed[0]):
        assert np.array_equal(np.unique(crossed[1][crossed[0] == s]), np.arange(192))
    for found in ((session, place, level), crossed):
        assert len({*zip(found[1], found[2], strict=True)}) == 192 * 260


def test_the_skin_stage_is_the_forward_model(tmp_path):
    chain(tmp_path)
    stage = stages.Stage(tmp_path / "0.parquet")
    (table, untouched, touched), channels = stage.joined(), stage.channels
    row = table.iloc[17]
    counts = site_counts(channels)
    chosen = settings([ELLIPSE], counts, (1, int(row["session"]), 0))
    geometry = apply_skin(Geometry.from_skin(Skin.from_metadata(SKIN)), chosen, START)
    forward = Forward(geometry, "train")
    touch = Touch(row["x_mm"], row["y_mm"], 8.0, 0.9 * row["force_N"])
    assert np.allclose(untouched[17], 1e-3 * forward.voltages(CHANNELS), rtol=1e-6)
    assert np.allclose(touched[17], 1e-3 * forward.voltages(CHANNELS, [touch]), rtol=1e-6)
    per_session = [untouched[rows] for rows in table.groupby("session").indices.values()]
    assert all((rows == rows[0]).all() for rows in per_session)
    assert not np.array_equal(per_session[0][0], per_session[1][0])


def test_the_untouched_frame_carries_the_gain_of_its_touch(tmp_path):
    chain(tmp_path)
    table, before, _ = stages.Stage(tmp_path / "0.parquet").joined()
    _, after, _ = stages.Stage(tmp_path / "1.parquet").joined()
    gain = 1 + 0.01 * (table["force_N"].to_numpy() - 5.0)
    assert np.allclose(after / before, gain[:, None], rtol=1e-5)


@pytest.mark.parametrize("baseline", ["paired", "averaged"])
def test_noise_and_baseline(tmp_path, baseline):
    found = dataset.read(chain(tmp_path, baseline=baseline))
    _, untouched, touched = stages.Stage(tmp_path / "1.parquet").joined()
    noise = (found.delta_V - (touched - untouched)) / np.median(np.abs(touched), axis=1)[:, None]
    frames = 12
    expected = 0.01 * np.sqrt(2.0 if baseline == "paired" else 1.0 + 1.0 / frames)
    assert noise.std() == pytest.approx(expected, rel=0.06)
    between = np.corrcoef(noise[:frames])[np.triu_indices(frames, 1)].mean()
    shared = 0.0 if baseline == "paired" else (1 / frames) / (1 + 1 / frames)
    assert between == pytest.approx(shared, abs=0.04)
    assert found.metadata["configuration"] == "authors" and len(found.table) == 30


@pytest.mark.parametrize(("given", "samples"), [({}, 30), ({"samples": 50}, 50)])
def test_a_continuous_set_has_its_own_size_or_the_grids(tmp_path, given, samples):
    laid, grid = tmp_path / "mesh.npz", tmp_path / "grid.csv"
    layout.write(laid, grid, layout.Layout(1, SKIN, {"drive": "adjacent"}, GRID, FORCES, "train"))
    forces = {key: FORCES[key] for key in ("mean_N", "sd_N", "max_N")}
    continuous = {"reach_mm": 64.0, "probe_mm": 16.0, "forces": forces, **given}
    out = tmp_path / "0.parquet"
    sets.write_skin_stage(
        laid, grid, out, sets.SkinStage(1, SKIN, "train", [ELLIPSE], 12, False, continuous)
    )
    table, *_ = stages.Stage(out).joined()
    assert len(table) == samples and table["place"].is_unique
    np.testing.assert_array_equal(table["session"], np.arange(samples) // 12)


def test_continuous_samples_have_places_and_forces_of_their_own():
    forces = {"mean_N": 5.0, "sd_N": 2.0, "max_N": 10.0}
    table = sets.continuous_samples(5000, 300, 1, 72.0, 16.0, forces)
    assert table["place"].is_unique and not table[["x_mm", "y_mm"]].duplicated().any()
    assert np.bincount(table["session"]).tolist() == [300] * 16 + [200]
    radius = np.hypot(table["x_mm"], table["y_mm"])
    assert radius.max() < 72.0
    assert (radius < 36.0).mean() == pytest.approx(0.25, abs=0.02)
    inside = table["force_N"][(table["force_N"] > 0) & (table["force_N"] < 10)]
    assert inside.is_unique and 0.98 < len(inside) / 5000 < 0.995
    assert table["force_N"].mean() == pytest.approx(5.0, abs=0.1)
    assert table["force_N"].std() == pytest.approx(2.0, abs=0.1)
    again = sets.continuous_samples(5000, 300, 1, 72.0, 16.0, forces)
    assert table.equals(again)


def test_a_continuous_set_is_of_its_configuration(tmp_path):
    chain(tmp_path)
    laid, grid, stage = (tmp_path / name for name in ("mesh.npz", "grid.csv", "own.parquet"))
    own = {"reach_mm": 72.0, "probe_mm": 16.0}
    own["forces"] = {"mean_N": 5.0, "sd_N": 2.0, "max_N": 10.0}
    sets.write_skin_stage(
        laid, grid, stage, sets.SkinStage(1, SKIN, "train", [ELLIPSE], 12, False, own)
    )
    out = tmp_path / "out.parquet"
    sets.write_dataset(stage, out, "authors-continuous", 1, 0.01, "paired")
    found = dataset.read(out)
    assert found.metadata["configuration"] == "authors"
    assert found.metadata["name"] == "simulated-authors-continuous"
    assert len(found.table) == 30 and found.table["place"].is_unique


def test_repeatable_byte_for_byte(tmp_path):
    first, second = (chain(tmp_path / name) for name in ("a", "b"))
    for file in ("mesh.npz", "grid.csv", "0.parquet", "1.parquet"):
        assert (first.parent / file).read_bytes() == (second.parent / file).read_bytes()
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.parametrize(
    "effect",
    [
        {"name": "conductivity-drift", "parameters": {"per_minute": 0.01}},
        {"name": "frame-skew", "parameters": {"fraction": 0.5}},
        {"name": "mains-interference", "parameters": {"frequency_Hz": 50.0, "volt": 1e-3}},
    ],
)
def test_samples_have_no_time(tmp_path, effect):
    chain(tmp_path)
    with pytest.raises(InputError, match="this one needs a recording"):
        if effect["name"] == "mains-interference":
            sets.write_stage(tmp_path / "0.parquet", tmp_path / "1.parquet", 1, effect, 1)
        else:
            laid, grid = tmp_path / "mesh.npz", tmp_path / "grid.csv"
            out = tmp_path / "x.parquet"
            sets.write_skin_stage(
                laid, grid, out, sets.SkinStage(1, SKIN, "train", [effect], 12, False)
            )


def test_the_chain_follows_the_instrument():
    names = ("crosstalk", "adc-nonlinearity", "channel-gain", "common-mode", "ground-leak")
    effects = [{"name": name} for name in (*names, "drive-gain")]
    assert list(links.instrument_effects(effects)) == [
        "1-channel-gain",
        "2-drive-gain",
        "3-crosstalk",
        "4-adc-nonlinearity",
    ]
    assert [e["name"] for e in links.skin_effects(effects)] == ["common-mode", "ground-leak"]
    assert links.link_before(effects, "1-channel-gain") == links.SKIN


def test_a_sample_s_touch_and_wires(tmp_path):
    """Effects on touch and wiring are in a set as in a recording."""
    chain(tmp_path)
    effects = [
        {"name": "contact-law", "parameters": {"exponent": 0.5}},
        {"name": "electrode-swap", "electrodes": [2, 5], "parameters": {}},
    ]
    laid, grid, out = (tmp_path / name for name in ("mesh.npz", "grid.csv", "swap.parquet"))
    sets.write_skin_stage(laid, grid, out, sets.SkinStage(1, SKIN, "train", effects, 12, False))
    table, _, touched = stages.Stage(out).joined()
    row = table.iloc[17]
    touch = Touch(row["x_mm"], row["y_mm"], 8.0, 0.9 * np.sqrt(row["force_N"]))
    wires = np.arange(16)
    wires[[2, 5]] = 5, 2
    impedance = Forward(Geometry.from_skin(Skin.from_metadata(SKIN)), "train").transfer_impedance(
        [touch]
    )
    expected = 1e-3 * channel_values(impedance, wires[CHANNELS])
    assert np.allclose(touched[17], expected, rtol=1e-5)
