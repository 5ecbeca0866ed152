"""A rectangle with electrodes on its rim and inside: a contact inside is named, and what cannot be
simulated is left out."""

import numpy as np
import pytest

from eitskin.data.recording import Recording, frames_table, metadata_of
from eitskin.diagnose.diagnosis import diagnose
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.search.catalogue import Conditions, catalogue
from eitskin.diagnose.verdict import words
from eitskin.diagnose.verdict.record import record
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import as_stated, laid_out
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate
from small_skin import STATED_ON_OUTLINE, problem_of

RATIO = 4.0
STATED = {
    **STATED_ON_OUTLINE,
    "outline": {"shape": "rectangle", "width_mm": 80.0, "height_mm": 60.0},
    "electrode_xy_mm": [
        *([-40.0, 5.0], [3.0, -30.0], [40.0, -4.0], [-2.0, 30.0]),
        *([-20.0, -14.0], [22.0, -12.0], [18.0, 15.0], [-19.0, 16.0]),
    ],
}
# Driven electrodes are measured too, or no contact would show.
CHANNELS = np.array(
    [(k, (k + 1) % 8, (k + j) % 8, (k + j + 1) % 8) for k in range(8) for j in range(7)]
)
PLACES = [(0.0, 0.0), (-30.0, 1.0), (28.0, 2.0), (1.0, 18.0), (-20.0, -13.0), (-23.5, -14.0)]


def recorded(*items, seed=1, noise=2e-4):
    """Presses of three forces at six places, the fifth over electrode 4, the last across its edge,
    which nobody simulates: it is read as untouched."""
    rng = np.random.default_rng(seed)
    force = np.concatenate([np.zeros(4), np.tile([0.0, 1.0, 2.0, 4.0], len(PLACES))])
    press = np.concatenate([np.zeros(4, int), np.repeat(np.arange(len(PLACES)), 4)])
    x, y = np.array(PLACES)[press].T
    frames = frames_table(0.1 * np.arange(len(force)), force > 0, x, y, force, 9.0)
    frames.loc[press == 4, "probe_mm"] = np.where(force[press == 4] > 0, 16.0, np.nan)
    simulated = frames.copy()
    simulated.loc[press == 5, "touch"] = False
    skin = Skin.from_metadata(STATED)
    chosen = settings(list(items), site_counts(CHANNELS), (0, 0))
    voltage = simulate(simulated, press, skin, CHANNELS, chosen)
    voltage += noise * np.median(np.abs(voltage)) * rng.normal(size=voltage.shape)
    metadata = metadata_of(CHANNELS, STATED, "a rectangle with electrodes inside")
    return Recording(frames, voltage, None, None, metadata)


def contact(electrode, ratio=RATIO):
    parameters = {"ratio": ratio}
    sites = {"electrodes": [electrode]}
    return {"name": "contact-impedance", **sites, "parameters": parameters}


def shifted(electrode, values):
    return {"name": "electrode-position", "electrodes": [electrode], "parameters": values}


def test_a_skin_is_laid_out_and_stated_again():
    skin = Skin.from_metadata(STATED)
    laid = laid_out(skin)
    assert laid_out(laid) == laid
    assert Geometry.from_skin(laid).inner.tolist() == [4, 5, 6, 7]
    again = as_stated(laid)
    assert np.allclose(again.electrode_xy_mm, skin.electrode_xy_mm)
    assert Skin.from_metadata(again.metadata()) == again


def test_touches_across_an_electrode_are_left_out():
    model = RecordingSimulator(recorded())
    assert model.simulable.tolist() == [True] * 25 + [False] * 3
    assert model.touched.sum() == 18


def test_what_is_not_modelled_inside_is_not_sought():
    recording = recorded()
    problem, scales = problem_of(recording)
    conditions = Conditions(
        recording.skin, problem.model.nominal_skin, site_counts(CHANNELS), False, False
    )
    candidates = catalogue(conditions, recording.voltage, scales)
    names = {c.name for c in candidates}
    assert not names & {"anisotropy", "conductivity-gradient", "third-dimension"}
    assert {"contact-impedance", "electrode-width", "domain-shape"} <= names
    keys = {
        c.sites: {key for key, _ in c.names} for c in candidates if c.name == "electrode-position"
    }
    along_rim, inside = {"shift_mm"}, {"dx_mm", "dy_mm"}
    single = {(site,): along_rim if site < 4 else inside for site in range(8)}
    assert keys == {**single, (0, 1, 2, 3): along_rim, (4, 5, 6, 7): inside}


def test_a_shift_is_along_the_rim_or_inside():
    for electrode, values, found in (
        (5, {"shift_mm": 1.0}, "found electrode 5, inside the skin, expected dx_mm and dy_mm"),
        (2, {"dx_mm": 1.0}, "found electrode 2, on the rim, expected shift_deg or shift_mm"),
    ):
        with pytest.raises(InputError, match=found):
            recorded(shifted(electrode, values))


@pytest.mark.long
def test_a_contact_inside_is_named():
    document = record(diagnose(recorded(contact(5))), "inside").document
    (effect,) = document["effects"]
    assert document["verdict"] == "explained"
    assert effect["name"] == "contact-impedance" and effect["electrodes"] == [5]
    ratio = effect["parameters"]["ratio"]
    assert ratio["low"] < RATIO < ratio["high"]


@pytest.mark.long
def test_an_electrode_inside_that_sits_wrongly_is_named_with_x_and_y():
    shift = {"dx_mm": 1.5, "dy_mm": -1.0}
    document = record(diagnose(recorded(shifted(6, shift))), "inside").document
    (effect,) = document["effects"]
    assert effect["name"] == "electrode-position" and effect["electrodes"] == [6]
    for key, value in shift.items():
        assert effect["parameters"][key]["low"] < value < effect["parameters"][key]["high"]
    text = " ".join(words.all_sentences(document))
    assert "along x" in text and "along y" in text and "rim" not in text.split("along y")[0]
