import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.data import splits
from eitskin.data.alignment import homogeneous_readings
from eitskin.data.dataset import Dataset
from eitskin.errors import InputError
from eitskin.learn import metrics, model_file, train, transfer, transfer_runs
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from synthetic_touches import touches

ANGLES = (np.arange(16) * 22.5).tolist()
CHANNELS = channel_table(16)
BUDGET = train.Budget(samples=None, epochs=20)
RECIPE = train.Recipe(train.Optimiser(), BUDGET, 5.0, latent_dim=4)


def described(data: Dataset, **metadata) -> Dataset:
    """The synthetic set with what a simulated set or a recording says of its channels."""
    metadata_columns = {
        "channels": CHANNELS.tolist(),
        "voltage": "signed",
        "position_frame": "skin",
    }
    return replace(data, metadata={**data.metadata, **metadata_columns, **metadata})


def recorded(data: Dataset, gain=1.0, offset=0.0, **metadata) -> Dataset:
    """The same touches by an instrument of another gain and offset (each (M,) or a number)."""
    values = (data.delta_V * gain + offset).astype(np.float32)
    recording_metadata = {"name": "bench", "configuration": "", **metadata}
    return described(replace(data, delta_V=values), **recording_metadata)


@functools.cache
def many():
    """A table of 2,000 touches, and its parts."""
    table = touches(2000, seed=2).table
    return table, splits.assign(table, "place", 1)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A trained model, its set and the set's parts."""
    data = described(touches(1500, seed=1))
    part = splits.assign(data.table, "random", 1)
    folder = tmp_path_factory.mktemp("model")
    paths = [folder / "1.pt", folder / "2.pt"]
    for seed, path in enumerate(paths, start=1):
        train.train_predictor(train.Split(data, part), "mlp", path, RECIPE, train.Seeds(1, seed))
    return model_file.read_seeds(paths), train.Split(data, part)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Fewer draws and steps than the workflow takes."""
    monkeypatch.setattr(transfer, "DRAWS", 3)
    monkeypatch.setattr(transfer, "STEPS", 100)


def drawn(target, part):
    """The labelled rows of every draw."""
    return [transfer_runs.labelled(target.table, part, 1 + draw) for draw in range(transfer.DRAWS)]


def run(simulated, target):
    part = splits.assign(target.table, "place", 1)
    return transfer.transferred(*simulated, train.Split(target, part), ANGLES, drawn(target, part))


def mean_errors(rows, variable="F"):
    error_rows = rows[(rows["metric"] == "mae") & (rows["variable"] == variable)]
    return error_rows.groupby("method")["value"].mean()


@given(st.integers(0, 1000))
def test_labels_are_whole_presses_of_the_training_part_near_5_percent(seed):
    table, part = many()
    labelled_rows = transfer_runs.labelled(table, part, seed)
    assert set(part[labelled_rows]) == {"train"}
    press = table["session"] * 1000 + table["place"]
    inside = np.isin(press, press[labelled_rows]) & (part == "train")
    assert inside.sum() == len(labelled_rows) == len(set(labelled_rows))
    largest = press.value_counts().max()
    assert abs(len(labelled_rows) - 0.05 * (part == "train").sum()) <= largest / 2
    np.testing.assert_array_equal(labelled_rows, transfer_runs.labelled(table, part, seed))


def test_labels_differ_from_draw_to_draw():
    table, part = many()
    draws = {tuple(transfer_runs.labelled(table, part, seed)) for seed in range(transfer.DRAWS)}
    assert len(draws) == transfer.DRAWS


def test_a_fifth_of_the_labelled_presses_is_validated_on():
    table, part = many()
    labelled_rows = transfer_runs.labelled(table, part, 1)
    parts = transfer.labelled_parts(table, labelled_rows, 1)
    press = (table["session"] * 1000 + table["place"]).to_numpy()
    assert set(parts[np.setdiff1d(np.arange(len(table)), labelled_rows)]) == {"unused"}
    checked, trained = (set(press[parts == name]) for name in ("validation", "train"))
    assert not checked & trained
    assert len(checked) == round(0.2 * len(checked | trained)) > 0


def test_few_frames_take_as_many_steps_as_the_whole_part():
    budget = train.Budget(samples=6000, epochs=60)
    longer = transfer.same_steps(budget, 2560, 100, train.Optimiser(batch_size=128))
    assert longer == train.Budget(samples=None, epochs=1200)
    capped = transfer.same_steps(budget, 100_000, 200, train.Optimiser(batch_size=128))
    assert capped.epochs == 60 * 47 // 2


def test_channels_are_found_by_their_electrodes_whatever_order_or_polarity():
    data = described(touches(20, seed=1))
    draw = np.random.default_rng(1)
    order, drive, measure = draw.permutation(208), *draw.integers(0, 2, (2, 208)).astype(bool)
    swapped = CHANNELS.copy()
    swapped[drive] = swapped[drive][:, [1, 0, 2, 3]]
    swapped[measure] = swapped[measure][:, [0, 1, 3, 2]]
    sign = np.where(drive ^ measure, -1.0, 1.0)
    target = recorded(data, gain=sign)
    target.delta_V = target.delta_V[:, order]
    target.metadata["channels"] = swapped[order].tolist()
    changes = transfer.as_simulated(target, data.metadata, None)
    np.testing.assert_array_equal(changes, data.delta_V.astype(float))


@pytest.mark.parametrize("drive", ["adjacent", "skip-1"])
def test_a_change_of_magnitude_gets_the_sign_of_its_reading(drive):
    channels = channel_table(16, drive)
    skin = Geometry(
        radius_mm=80,
        thickness_mm=3,
        conductivity_S_per_m=0.5,
        electrode_deg=np.array(ANGLES),
        electrode_width_mm=5,
        contact_impedivity_ohm_m2=2e-3,
    )
    forward = Forward(skin, "train")
    untouched = forward.voltages(channels)
    change = forward.place(x_mm=20, y_mm=31, radius_mm=5).channel_change(channels, np.array([5.0]))
    magnitude = np.abs(untouched + change) - np.abs(untouched)
    data = touches(1, seed=1)
    data = replace(data, delta_V=magnitude.astype(np.float32))
    target = described(data, voltage="magnitude", channels=channels.tolist())
    source = {"name": "simulated-x", "channels": channels.tolist()}
    changes = transfer.as_simulated(target, source, ANGLES)
    np.testing.assert_allclose(changes, change, rtol=1e-5, atol=1e-9 * np.abs(change).max())


def test_what_cannot_be_compared_is_refused():
    data = described(touches(20, seed=1))
    short = described(data, channels=CHANNELS[:-3].tolist())
    with pytest.raises(InputError, match="3 of the 208 of waves missing"):
        transfer.as_simulated(short, data.metadata, ANGLES)
    unsigned = described(data, voltage="magnitude")
    with pytest.raises(InputError, match="electrodes whose angles are unknown"):
        transfer.as_simulated(unsigned, data.metadata, None)
    across = channel_table(16, "opposite", "opposite")
    without_sign = np.abs(homogeneous_readings(across, np.array(ANGLES))) < 1e-9
    assert without_sign.any()
    data.delta_V = data.delta_V[:, : len(across)]
    unsigned = described(data, voltage="magnitude", channels=across.tolist())
    with pytest.raises(InputError, match=f"{without_sign.sum()} magnitudes that are zero"):
        transfer.as_simulated(unsigned, unsigned.metadata, ANGLES)


def domains(seed, n=300, m=7):
    draw = np.random.default_rng(seed)
    recording, simulation = (
        draw.normal(size=(n, m)) @ draw.normal(size=(m, m)) + draw.normal(size=m) for _ in "ab"
    )
    return recording, simulation


@given(st.integers(0, 1000))
def test_z_scores_take_on_the_other_domain_s_mean_and_spread(seed):
    recording, simulation = domains(seed)
    scored = transfer.z_scored(recording, recording, simulation)
    np.testing.assert_allclose(scored.mean(axis=0), simulation.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(scored.std(axis=0), simulation.std(axis=0))


@given(st.integers(0, 1000))
def test_coral_brings_one_covariance_to_the_other(seed):
    recording, simulation = domains(seed)
    identity = np.eye(recording.shape[1])
    centred = recording.mean(axis=0) + recording.std(axis=0) * identity  # z = rows of the identity
    mapped = (
        transfer.coral(centred, recording, simulation) - simulation.mean(axis=0)
    ) / simulation.std(axis=0)
    correlation = [np.cov(((v - v.mean(0)) / v.std(0)).T) for v in (recording, simulation)]
    np.testing.assert_allclose(
        mapped.T @ (correlation[0] + identity) @ mapped, correlation[1] + identity, atol=1e-8
    )
    np.testing.assert_allclose(
        transfer.coral(recording, recording, recording), recording, atol=1e-8
    )
    scaled = transfer.coral(3.0 * recording + 2.0, 3.0 * recording + 2.0, simulation)
    np.testing.assert_allclose(scaled, transfer.coral(recording, recording, simulation), atol=1e-8)


def test_the_affine_map_undoes_an_affine_error_and_leaves_a_right_model_alone():
    draw = np.random.default_rng(1)
    truth = draw.normal(size=(4000, 3)) * [40.0, 40.0, 3.0]
    scale = truth.std(axis=0)
    turned = (truth - [1.0, 2.0, 3.0]) @ np.array([[0.8, 0.1, 0], [-0.1, 0.7, 0], [0, 0, 1.5]])
    mapped = transfer.affine(turned[2000:], turned[:2000], truth[:2000], scale)
    np.testing.assert_allclose(mapped / scale, truth[2000:] / scale, atol=0.01)
    unchanged = transfer.affine(truth[2000:], truth[:2000], truth[:2000], scale)
    np.testing.assert_allclose(unchanged, truth[2000:])
    mapped_by_two = transfer.affine(turned[2000:], turned[:2], truth[:2], scale)
    assert np.isfinite(mapped_by_two).all()


def test_isotonic_forces_rise_and_stay_within_what_was_labelled():
    draw = np.random.default_rng(1)
    truth = draw.uniform(0, 10, 200)
    predicted = truth**2 / 10
    forces = transfer.isotonic(np.linspace(-5, 30, 50), predicted, truth)
    assert (np.diff(forces) >= 0).all()
    assert forces.min() == truth.min() and forces.max() == truth.max()
    np.testing.assert_allclose(transfer.isotonic(predicted, predicted, truth), truth)


def test_the_adapter_mends_a_gain_and_does_not_stray_without_cause(simulated):
    model, source = simulated
    data = source.dataset
    states = transfer.predict_seeds(model, data.delta_V)[0]
    labelled_changes = data.delta_V[:200].astype(float)
    gain, shift = transfer.adapter(model, 1, labelled_changes, states[:200], [0, 1, 2])
    np.testing.assert_allclose(gain, 1.0, atol=0.01)
    np.testing.assert_allclose(shift, 0.0, atol=0.01)
    target = recorded(data, gain=1.5)
    errors = mean_errors(run(simulated, target))
    assert errors["CORAL + adapter"] < errors["zero-shot"]


def test_another_gain_is_mended_without_labels_and_an_ideal_recording_needs_nothing(simulated):
    data = touches(1200, seed=5)
    ideal = mean_errors(run(simulated, recorded(data)))
    gained = mean_errors(run(simulated, recorded(data, gain=2.0, offset=5e-4)))
    assert ideal["zero-shot"] < 0.5 * gained["zero-shot"]
    assert gained["z-score"] < 0.5 * gained["zero-shot"]
    assert gained["CORAL"] < 0.5 * gained["zero-shot"]
    assert gained["isotonic"] < gained["zero-shot"]
    assert gained["affine"] < gained["zero-shot"]
    assert gained["z-score"] == pytest.approx(ideal["z-score"], rel=1e-2)


def test_every_method_has_its_runs(simulated):
    rows = run(simulated, recorded(touches(1200, seed=5)))
    assert set(rows["left_out"]) == {""} and list(rows.columns) == list(transfer_runs.RUNS)
    methods = {method for method in transfer_runs.METHODS if method in set(rows["method"])}
    assert methods == set(transfer_runs.METHODS) - {
        transfer_runs.CONSTANT,
        transfer_runs.NEAREST,
        transfer_runs.TRAINED_FEW,
        transfer_runs.TRAINED_ALL,
    }
    for method, group in rows.groupby("method"):
        of_variables = 3 * (1 if method.endswith("isotonic") else 3)
        drawn = transfer_runs.METHODS[method] == transfer_runs.FEW_LABELS
        assert len(group) == of_variables * (transfer.DRAWS if drawn else 2), method
        assert (group["draw"] >= 0).all() == drawn
        assert set(group["seed"]) == {1, 2}


def test_labels_beyond_the_5_percent_and_the_test_part_are_not_used(simulated):
    target = recorded(touches(1200, seed=5))
    part = splits.assign(target.table, "place", 1)
    rows = run(simulated, target)
    used = drawn(target, part)
    unused = np.setdiff1d(np.flatnonzero(part != "test"), np.concatenate(used))
    assert len(unused) > 200
    target.table.loc[unused, ["x_mm", "y_mm", "force_N"]] = 1e6
    repeated = transfer.transferred(*simulated, train.Split(target, part), ANGLES, used)
    assert rows.equals(repeated)
    target.table.loc[used[0], "force_N"] += 3.0
    changed = transfer.transferred(*simulated, train.Split(target, part), ANGLES, used)
    unlabelled = rows["method"].isin(["zero-shot", "z-score", "CORAL"])
    assert rows[unlabelled].equals(changed[unlabelled]) and not rows.equals(changed)


def test_what_differs_is_left_out_with_its_reason(simulated):
    data = touches(1200, seed=5)
    rows = run(simulated, recorded(data, position_frame="robot", unit="arbitrary"))
    reasons = rows[rows["left_out"] != ""].set_index(["method", "variable"])["left_out"]
    assert "robot" in reasons["", "x"] and "robot" in reasons["", "y"]
    for method in ("zero-shot", "affine", "isotonic"):
        assert reasons[method, ""] == "changes are in arbitrary, the simulation's in V"
    compared = rows[rows["left_out"] == ""]
    assert set(compared["variable"]) == {"F"}
    assert set(compared["method"]) == {
        *("z-score", "CORAL", "CORAL + adapter", "CORAL + adapter + isotonic")
    }
    rows = run(simulated, recorded(data, channels=CHANNELS[::-1][:-1].tolist()))
    assert len(rows) == 1 and "1 of the 208 of waves missing" in rows["left_out"][0]
    rows = run(simulated, recorded(data, targets=["x", "y"]))
    reason = rows.loc[rows["left_out"] != "", ["variable", "left_out"]].to_numpy().tolist()
    assert reason == [["F", "not known in the recording, or the same in every frame"]]
    assert "isotonic" not in set(rows["method"])


def test_the_nearest_touches_are_the_most_alike_whatever_the_strength():
    data = touches(400, seed=1, noise=0.0)
    states, reference_rows = data.states(), np.arange(400) >= 0
    nearest = transfer.nearest_states(data.delta_V, reference_rows, np.arange(400), states)
    places_and_counts = [*np.unique(data.table["place"], return_counts=True)]
    crowded = np.isin(data.table["place"], places_and_counts[0][places_and_counts[1] >= 3])
    np.testing.assert_allclose(nearest[crowded, :2], states[crowded, :2])
    stronger = transfer.nearest_states(3.0 * data.delta_V, reference_rows, np.arange(400), states)
    np.testing.assert_allclose(nearest[crowded, :2], stronger[crowded, :2])
    alone = transfer.nearest_states(data.delta_V, reference_rows, np.array([7]), states[[7]])
    np.testing.assert_allclose(alone, np.broadcast_to(states[7], states.shape))


def test_references_need_no_simulation(tmp_path):
    target = recorded(touches(1000, seed=5))
    part = splits.assign(target.table, "place", 1)
    budget = train.Budget(samples=None, epochs=3)
    job = (train.Optimiser(), budget, train.Seeds(1, 1))
    train.train_autoencoder(train.Split(target, part), tmp_path / "a.pt", *job, 4)
    train.train_regressor(train.Split(target, part), tmp_path / "a.pt", tmp_path / "r.pt", *job)
    teachers = [tmp_path / "a.pt", tmp_path / "r.pt"]
    name, model_path = "physics-informed-mlp", tmp_path / "whole.pt"
    recipe = train.Recipe(train.Optimiser(), budget, 5.0, 0.03, latent_dim=4)
    train.train_predictor(
        train.Split(target, part), name, model_path, recipe, train.Seeds(1, 1), teachers
    )
    rows = transfer.references(model_file.read(model_path), target, part, recipe, 1)
    assert set(rows["left_out"]) == {""}
    drawn = [transfer_runs.CONSTANT, transfer_runs.NEAREST, transfer_runs.TRAINED_FEW]
    assert set(rows["method"]) == {*drawn, transfer_runs.TRAINED_ALL}
    cell = rows[(rows["metric"] == "mae") & (rows["variable"] == "F")]
    constant = cell[cell["method"] == transfer_runs.CONSTANT].set_index("draw")["value"]
    force = target.table["force_N"].to_numpy()
    for draw in range(transfer.DRAWS):
        labelled_rows = transfer_runs.labelled(target.table, part, 1 + draw)
        guess = np.full((part == "test").sum(), force[labelled_rows].mean())
        assert constant[draw] == pytest.approx(metrics.mae(force[part == "test"], guess))
    for method in drawn:
        assert len(cell[cell["method"] == method]) == transfer.DRAWS
    assert len(cell[cell["method"] == transfer_runs.TRAINED_ALL]) == 1
    repeated = transfer.references(model_file.read(model_path), target, part, recipe, 1)
    assert rows.equals(repeated)


def test_too_few_labels_to_train_on_are_said(tmp_path):
    target = recorded(touches(300, seed=5))
    target.table["place"] = np.arange(300) // 75
    target.table["session"] = 0
    target.table["x_mm"] = target.table["place"] * 10.0
    part = splits.assign(target.table, "place", 1)
    train.train_predictor(
        train.Split(target, part), "mlp", tmp_path / "mlp.pt", RECIPE, train.Seeds(1, 1)
    )
    rows = transfer.references(model_file.read(tmp_path / "mlp.pt"), target, part, RECIPE, 1)
    (reason,) = rows.loc[rows["method"] == transfer_runs.TRAINED_FEW, "left_out"]
    assert reason == "bench: training state: found no spread, expected some"


def test_written_twice_equal_bytes(simulated, tmp_path):
    rows = run(simulated, recorded(touches(600, seed=5)))
    for name in "ab":
        metrics.write(rows, tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
