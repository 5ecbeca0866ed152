"""effects.yaml: the configuration takes it as it is, and simulates what was found."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from eitskin.configuration import validate
from eitskin.data import recording
from eitskin.data.subset import of_frames
from eitskin.diagnose.fitting.candidates import Candidate
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.jacobian import Jacobian
from eitskin.diagnose.fitting.simulator import RecordingSimulator
from eitskin.diagnose.verdict import corrected
from eitskin.effects import EFFECTS
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from eitskin.simulate.twin import Twin
from eitskin.simulate.twin import write as write_twin
from small_skin import (
    CHANNELS,
    SKIN,
    calibrated,
    candidates_of,
    kinds_of,
    problem_of,
    small_recording,
)

ROOT = Path(__file__).parents[4]
SCHEMA = ROOT / "workflow" / "schemas" / "config.schema.yaml"


def merged(over, under):
    """As Snakemake lays one configuration over another."""
    if not isinstance(over, dict):
        return over
    both = dict(under) if isinstance(under, dict) else {}
    return both | {key: merged(value, both.get(key)) for key, value in over.items()}


def accepted(text, tmp_path):
    """The whole configuration with the text laid over it; InputError where it is refused."""
    path = tmp_path / "effects.yaml"
    path.write_text(text, encoding="utf-8")
    default = ROOT / "config.yaml"
    config = merged(yaml.safe_load(text), yaml.safe_load(default.read_text(encoding="utf-8")))
    validate(config, SCHEMA, [default, path])
    return config


def found_with(*effects):
    """A fit of candidates, at their start but for the first coordinate, and its recording."""
    recorded = small_recording(places=2)
    problem, _ = problem_of(recorded)
    start = calibrated(problem)
    theta = np.concatenate([start.theta, *(0.02 * np.ones(c.size) for c in effects)])
    jacobian = np.zeros((len(theta), *recorded.voltage.shape))
    return replace(start, effects=list(effects), theta=theta, slopes=Jacobian(jacobian)), recorded


RECORDED = small_recording(places=2)
KINDS = [
    c
    for c in kinds_of(candidates_of(RECORDED, *problem_of(RECORDED)))
    if c.name not in ("mains-interference", "indenter-grounding")
]


@pytest.mark.parametrize("name", sorted({c.name for c in KINDS}))
def test_every_effect_is_accepted(name, tmp_path):
    for candidate in [c for c in KINDS if c.name == name][:3]:
        found, recorded = found_with(candidate)
        text = corrected.yaml_text(found, recorded, np.full(40, 1e-5), "My skin")
        config = accepted(text, tmp_path)
        (effect,) = config["twin"]["effects"]
        assert effect["name"] == name
        in_set = config["configurations"]["corrected-my-skin"]["effects"]
        timed = candidate.effect.stage == "clock" or candidate.effect.driver in (
            "time",
            "load-direction",
        )
        assert in_set == ([] if timed else [effect])
        assert ("In the twin alone" in text) == timed


def test_the_twin_reads_as_the_fit_does(tmp_path):
    """The twin's own frames, simulated by the fit's model, are what `twin` writes."""
    planted = {"name": "force-dependent-gain", "parameters": {"per_N": 0.004}}
    recorded = small_recording(planted, noise=1e-4, places=3)
    problem, scales = problem_of(recorded, noise=1e-4)
    chosen = next(
        c for c in candidates_of(recorded, problem, scales) if c.name == "force-dependent-gain"
    )
    found = fit(problem, [chosen], np.zeros(2), polish=True)
    text = corrected.yaml_text(found, recorded, problem.whitening.sd, "skin")
    config = accepted(text, tmp_path)
    small = {"touch_grid": {"radii": 1, "angles": 3, "inner": 0.5, "outer": 0.5}}
    small["press"] = config["twin"]["press"] | {"probes_mm": [8.0], "sessions_per_probe": 1}
    write_twin(tmp_path / "twin.parquet", Twin(**(config["twin"] | small | {"noise": 0.0})))
    twin = recording.read(tmp_path / "twin.parquet")
    model = RecordingSimulator(twin, problem.model)
    knobs, settings = problem.split(found.theta, found.effects)
    expected = np.abs(model.voltage(knobs, settings))
    assert np.allclose(twin.voltage, expected, rtol=1e-9)
    assert np.isclose(config["twin"]["noise"], 1e-4, rtol=0.05)
    assert config["twin"]["skin"]["conductivity_S_per_m"] == pytest.approx(0.5, rel=1e-3)


def test_what_the_owner_did_not_know_is_filled_in(tmp_path):
    recorded = small_recording(places=2)
    skin = recorded.metadata["skin"] | {
        "electrode_deg": None,
        "contrast_per_N": None,
        "current_A": None,
        "electrode_width_mm": None,
    }
    recorded.metadata = recorded.metadata | {"skin": skin, "unit": "arbitrary"}
    problem, _ = problem_of(recorded)
    text = corrected.yaml_text(calibrated(problem), recorded, problem.whitening.sd, "skin")
    filled = accepted(text, tmp_path)["twin"]["skin"]
    assert None not in filled.values() and len(filled["electrode_deg"]) == 8
    assert "times as much is the recording's unit" in text


@pytest.mark.parametrize("radius_mm", [None, SKIN.radius_mm])
def test_a_skin_of_unknown_size_says_that_its_radius_stands_for_any(radius_mm, tmp_path):
    every = small_recording(places=2)
    recorded = of_frames(every, ~every.frames["touch"].to_numpy(bool))
    lengths = ("thickness_mm", "electrode_width_mm", "contact_impedivity_ohm_m2")
    skin = recorded.metadata["skin"] | dict.fromkeys(lengths) | {"radius_mm": radius_mm}
    recorded.metadata = recorded.metadata | {"skin": skin}
    problem, _ = problem_of(recorded)
    text = corrected.yaml_text(calibrated(problem), recorded, problem.whitening.sd, "skin")
    accepted(text, tmp_path)
    assert ("shares of radius_mm" in text) is (radius_mm is None)


def test_ohms_are_volts_at_one_ampere(tmp_path):
    recorded = small_recording(places=2)
    recorded.metadata = recorded.metadata | {"unit": "ohm"}
    recorded.voltage = recorded.voltage / SKIN.current_A
    problem, _ = problem_of(recorded)
    text = corrected.yaml_text(calibrated(problem), recorded, problem.whitening.sd, "skin")
    config = accepted(text, tmp_path)
    assert config["twin"]["skin"]["current_A"] == 1.0
    assert np.isclose(config["twin"]["noise"], 1e-3, rtol=0.05)


@pytest.mark.parametrize("measure", ["adjacent", "skip-1", None])
def test_the_protocol_is_the_recording_s(measure, tmp_path):
    channels = CHANNELS[::-1] if measure is None else channel_table(8, "adjacent", measure)
    recorded = small_recording(places=2)
    recorded.metadata = recorded.metadata | {"channels": channels.tolist()}
    recorded.voltage = np.full((len(recorded.frames), len(channels)), 0.04)
    problem, _ = problem_of(replace(recorded))
    found = calibrated(problem)
    text = corrected.yaml_text(found, recorded, np.full(len(channels), 1e-5), "skin")
    protocol = accepted(text, tmp_path)["protocol"]
    assert np.array_equal(channel_table(8, **protocol), channels)
    assert ("channels" in protocol) == (measure is None)


def test_a_body_is_written_at_the_accuracy_that_it_was_fitted_at(tmp_path):
    """Of electrodes as low as these, a finer solution has too many terms."""
    recorded = small_recording(places=2)
    problem, scales = problem_of(recorded)
    problem.model.coarse = True
    low = {"depth_mm": 3.0 * SKIN.radius_mm, "electrode_height_mm": 0.01 * SKIN.radius_mm}
    body = Candidate(EFFECTS["third-dimension"], None, None, "common", low, SKIN, scales)
    start = calibrated(problem)
    theta = np.r_[start.theta, np.zeros(body.size)]
    jacobian = Jacobian(np.zeros((len(theta), *recorded.voltage.shape)))
    found = replace(start, effects=[body], theta=theta, slopes=jacobian)
    with pytest.raises(InputError, match="apart"):
        problem.model.voltage(*problem.split(theta, [body]), accuracy="diagnose")
    (effect,) = accepted(corrected.yaml_text(found, recorded, np.full(40, 1e-5), "tank"), tmp_path)[
        "twin"
    ]["effects"]
    assert effect["parameters"]["depth_mm"] == pytest.approx(low["depth_mm"])
