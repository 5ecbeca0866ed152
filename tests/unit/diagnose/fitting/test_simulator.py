"""A simulator whose touches are moved, against the recording of those touches; and the size of a
skin, which no reading tells where no length is known."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.data.subset import of_frames
from eitskin.diagnose.fitting.readings import problem_of
from eitskin.diagnose.fitting.simulator import UNKNOWN, RecordingSimulator
from eitskin.diagnose.noise.noise_model import NoiseModel
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.physics.solver import forward_model
from small_skin import SKIN, small_recording


@pytest.fixture(scope="module")
def recorded():
    """A small recording."""
    return small_recording(places=4)


@pytest.fixture(scope="module")
def steps(recorded):
    """By how much states move, in untouched frames too; the lightest touches are lifted off."""
    draw = np.random.default_rng(3)
    count = len(recorded.frames)
    return {
        "x_mm": draw.normal(size=count),
        "y_mm": draw.normal(size=count),
        "force_N": draw.normal(size=count) - 0.5,
    }


def moved(recorded, steps):
    """The recording whose touches were there in the first place."""
    touched = recorded.frames["touch"].to_numpy(bool)
    own = {k: recorded.frames[k] + np.where(touched, step, 0.0) for k, step in steps.items()}
    own["force_N"] = own["force_N"].clip(lower=0.0)
    return replace(recorded, frames=recorded.frames.assign(**own))


def test_displaced_touches_read_as_if_they_had_been_recorded_there(recorded, steps):
    model, coordinates = RecordingSimulator(recorded), np.array([0.1])
    before = model.voltage(coordinates, [])
    found = model.with_displacements(steps).voltage(coordinates, [])
    expected = RecordingSimulator(moved(recorded, steps), model).voltage(coordinates, [])
    assert np.array_equal(found, expected)
    assert np.abs(found - before)[model.touched].max() > 1e-3 * np.abs(before).max()
    assert np.array_equal(found[~model.touched], before[~model.touched])
    assert np.array_equal(model.voltage(coordinates, []), before)


def test_untouched_frames_stay_and_no_force_is_negative(recorded, steps):
    model = RecordingSimulator(recorded)
    states = model.with_displacements(steps).states
    force = states["force_N"].to_numpy()
    expected = model.states["force_N"].to_numpy() + steps["force_N"]
    assert (expected[model.touched] < 0).any() and force.min() == 0.0
    heavy = model.touched & (expected > 0)
    assert np.allclose(force[heavy], expected[heavy])
    assert states[~model.touched].equals(model.states[~model.touched])
    assert np.array_equal(states["touch"], model.states["touch"])


def test_displaced_twice_is_displaced_by_both(recorded, steps):
    model, coordinates = RecordingSimulator(recorded), np.zeros(1)
    once = model.with_displacements({"x_mm": steps["x_mm"]})
    twice = once.with_displacements({"y_mm": steps["y_mm"]}).voltage(coordinates, [])
    both = model.with_displacements({k: steps[k] for k in ("x_mm", "y_mm")}).voltage(
        coordinates, []
    )
    assert np.allclose(twice, both, rtol=1e-9)
    assert not np.allclose(once.voltage(coordinates, []), both)
    assert model.with_displacements({}).states.equals(model.states)


@pytest.mark.parametrize("current_A", [1e-3, None])
def test_readings_that_are_all_zero_are_refused(recorded, current_A):
    skin = {**recorded.metadata["skin"], "current_A": current_A}
    metadata = {**recorded.metadata, "skin": skin}
    none = replace(recorded, voltage=np.zeros_like(recorded.voltage), metadata=metadata)
    noise = NoiseModel(np.full(none.voltage.shape[1], 1e-6), 100.0, "given")
    with pytest.raises(InputError, match="column voltage_V: found 0 in every frame"):
        problem_of(none, noise)


def differences(recorded, **metadata):
    """The same recording as differences from an untouched frame, of unknown scale."""
    metadata = {**recorded.metadata, "values": "difference", **metadata}
    voltage = recorded.voltage - recorded.voltage[~recorded.frames["touch"]].mean(axis=0)
    return replace(recorded, voltage=voltage, metadata=metadata)


def unscaled(recorded):
    """The metadata of a recording whose scale nobody knows, in both ways."""
    skin = {**recorded.metadata["skin"], "current_A": None}
    return {"unit": "arbitrary"}, {"skin": skin}


@pytest.mark.parametrize("way", [0, 1])
def test_differences_of_unknown_scale_need_a_touch(recorded, way):
    still = ~recorded.frames["touch"].to_numpy(bool)
    frames = recorded.frames[still].reset_index(drop=True)
    alone = replace(recorded, frames=frames, voltage=recorded.voltage[still])
    with pytest.raises(InputError, match="column voltage_V: found differences of unknown scale"):
        RecordingSimulator(differences(alone, **unscaled(recorded)[way]))


@pytest.mark.parametrize("way", [0, 1])
def test_differences_of_unknown_scale_start_from_that_of_touched_frames(recorded, way):
    """Most frames are untouched: their differences are noise alone."""
    rows = np.flatnonzero(recorded.frames["touch"].to_numpy(bool))[:3]
    rows = np.sort(np.append(rows, np.flatnonzero(~recorded.frames["touch"].to_numpy(bool))))
    few = replace(recorded, frames=recorded.frames.iloc[rows].reset_index(drop=True))
    few.voltage = 5.0 * recorded.voltage[rows]
    model = RecordingSimulator(differences(few, **unscaled(recorded)[way]))
    starts = {c.name: c.start for c in model.calibrations}
    scale = starts["current_A"] / 1e-3 if way else starts["factor"]
    assert np.isclose(scale, 5.0, rtol=0.1)


@pytest.mark.parametrize("deep", [{}, {"electrode_height_mm": 4.0, "electrode_z_mm": 10.0}])
@pytest.mark.parametrize("scale", [0.3, 4.0])
def test_readings_are_alike_at_every_size(deep, scale):
    """Of a skin scaled as a whole, contacts too, less the resistance of its material."""

    def impedance(skin):
        geometry = Geometry.from_skin(skin)
        return forward_model(replace(geometry, deep=bool(deep)), "train").transfer_impedance()

    lengths = ("radius_mm", "thickness_mm", "electrode_width_mm", "contact_impedivity_ohm_m2")
    body = replace(SKIN, thickness_mm=20.0, **deep)
    scaled = {key: scale * getattr(body, key) for key in (*lengths, *deep)}
    expected = impedance(body)
    actual = scale * impedance(replace(body, **scaled))
    np.testing.assert_allclose(actual, expected, atol=1e-6 * np.abs(expected).max())


UNSTATED = replace(
    SKIN, radius_mm=None, thickness_mm=None, electrode_width_mm=None, contact_impedivity_ohm_m2=None
)


@pytest.mark.parametrize(
    ("stated", "touched", "known"),
    [
        ({}, False, False),
        ({"electrode_width_mm": 0.0}, False, False),  # points have no length
        ({"electrode_width_mm": 5.0}, False, True),
        ({"thickness_mm": 3.0}, False, False),  # a sheet reads alike at every thickness
        ({"electrode_height_mm": 3.0, "electrode_z_mm": 5.0}, False, True),
        ({"contact_impedivity_ohm_m2": 2e-3}, False, True),  # SKIN's conductivity is stated
        (
            {"contact_impedivity_ohm_m2": 2e-3, "conductivity_S_per_m": None},
            False,
            False,
        ),
        ({}, True, True),
    ],
)
def test_a_radius_is_calibrated_where_a_length_tells_it(recorded, stated, touched, known):
    skin = replace(UNSTATED, **stated).metadata()
    rows = recorded.frames["touch"].to_numpy(bool) == touched
    part = of_frames(replace(recorded, metadata={**recorded.metadata, "skin": skin}), rows)
    model = RecordingSimulator(part)
    assert ("radius_mm" in [item.name for item in model.calibrations]) is known
    assert model.is_scaleless is not known
    assert model.nominal_skin.radius_mm == UNKNOWN["radius_mm"][0]
