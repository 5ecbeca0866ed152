"""A rectangle whose owner does not know all: its culprit is named in the words of an outline."""

import numpy as np
import pytest
import yaml

from eitskin.data import recording
from eitskin.data.recording import Recording, frames_table, metadata_of
from eitskin.diagnose.diagnosis import diagnose
from eitskin.diagnose.verdict import words
from eitskin.diagnose.verdict.record import record
from eitskin.physics.forward import Forward
from eitskin.physics.geometry import Geometry
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from small_skin import STATED_ON_OUTLINE

N = 16
SHIFT_MM = 2.0
WIDTH_MM, HEIGHT_MM = 150.0, 70.0
STATED = {
    **STATED_ON_OUTLINE,
    "outline": {"shape": "rectangle", "width_mm": WIDTH_MM, "height_mm": HEIGHT_MM},
    "electrode_s": [(k + 0.3) / N for k in range(N)],
}


def recorded(shift_mm: float, electrode: int, seed: int) -> Recording:
    """Nine presses of three forces, untouched frames between them; noise of 0.02 % of the median
    reading."""
    rng = np.random.default_rng(seed)
    believed = Geometry.from_skin(Skin.from_metadata(STATED))
    angles = believed.electrode_deg.copy()
    angles[electrode] += np.degrees(shift_mm / believed.radius_mm)
    skin = Forward(believed.with_values(electrode_deg=angles))
    channels = channel_table(N, "adjacent", "adjacent")
    untouched = skin.voltages(channels)
    readings, labels = [], []
    for x in (-55.0, 0.0, 55.0):
        for y in (-22.0, 0.0, 22.0):
            modes = skin.place(x, y, 4.0)
            readings += 2 * [untouched]
            labels += 2 * [(False, np.nan, np.nan, 0.0)]
            for force_N in (1.0, 2.0, 4.0):
                change = modes.channel_change(channels, [0.5 * force_N])[0]
                readings.append(untouched + change)
                labels.append((True, x, y, force_N))
    voltage = 1e-3 * np.array(readings)
    voltage += 2e-4 * np.median(np.abs(voltage)) * rng.normal(size=voltage.shape)
    touch, x_mm, y_mm, force_N = (np.array(column) for column in zip(*labels, strict=True))
    time_s = 0.1 * np.arange(len(touch))
    frames = frames_table(time_s, touch, x_mm, y_mm, force_N, 8.0)
    metadata = metadata_of(channels, STATED, "a rectangle with an electrode off its place")
    return Recording(frames, voltage, None, None, metadata)


def test_a_recording_of_a_rectangle_is_written_and_read(tmp_path):
    shifted = recorded(0.0, 3, 1)
    recording.write(shifted, tmp_path / "r.parquet")
    again = recording.read(tmp_path / "r.parquet")
    assert again.skin == shifted.skin and again.n_electrodes == N


@pytest.mark.long
def test_an_electrode_off_its_place_on_a_rectangle_is_named_in_mm():
    diagnosed = diagnose(recorded(SHIFT_MM, 3, 2))
    answer = record(diagnosed, "rectangle")
    document = answer.document
    (effect,) = document["effects"]
    assert document["verdict"] == "explained"
    assert effect["name"] == "electrode-position" and effect["electrodes"] == [3]
    shift = effect["parameters"]["shift_mm"]
    assert shift["unit"] == "mm" and shift["low"] < SHIFT_MM < shift["high"]
    assert "along the rim" in " ".join(words.all_sentences(document))
    assert not {"third-dimension", "conductivity-gradient"} & set(document["unobservable"])
    corrected = yaml.safe_load(answer.simulator)["skin"]
    assert corrected["radius_mm"] is None and corrected["electrode_deg"] is None
    np.testing.assert_allclose(corrected["electrode_s"], STATED["electrode_s"])
    Geometry.from_skin(Skin.from_metadata(corrected))
