"""Queries by other channels than their recording's: what was found of electrodes and skin predicts
any of them, what was found of drives, pairs and channels predicts its own."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin.data import recording
from eitskin.data.recording import Recording
from eitskin.data.subset import of_frames
from eitskin.diagnose.fitting.channel_mapping import mapped_setting, unmapped_channels
from eitskin.diagnose.fitting.fit import fit
from eitskin.diagnose.fitting.query import predict
from eitskin.diagnose.verdict.record import read_query
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table, every_channel
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate
from small_skin import CHANNELS, METADATA, SKIN, candidates_of, problem_of, small_recording, states

CONTACT = {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": 1.6}}
DRIVE = {"name": "drive-gain", "drives": [2], "parameters": {"gain": 1.1}}
PAIRS = {
    "name": "measurement-gain",
    "measures": list(range(8)),
    "parameters": {"gain": (1.0 + 0.02 * np.sin(np.arange(8))).tolist()},
}
EVERYWHERE = every_channel(8, "adjacent", "adjacent")
SKIPPING = channel_table(8, "skip-2")


def diagnosed(*items):
    """A fit of effects to a recording without noise, and the recording."""
    recorded = small_recording(*items, noise=0.0, places=3)
    problem, scales = problem_of(recorded)
    known = candidates_of(recorded, problem, scales)
    effects = []
    for item in items:
        kind = next(key for key in ("electrodes", "drives", "measures") if key in item)
        key = item["name"], kind, tuple(item[kind])
        effects.append(next(c for c in known if (c.name, c.kind, c.sites) == key))
    size = len(problem.model.calibrations) + sum(effect.size for effect in effects)
    return fit(problem, effects, np.zeros(size), polish=True), recorded


@pytest.fixture(scope="module")
def contact():
    """A contact found."""
    return diagnosed(CONTACT)


@pytest.fixture(scope="module")
def gains():
    """A contact, a drive's gain and those of every measuring pair found."""
    return diagnosed(CONTACT, DRIVE, PAIRS)


def query(channels, skin: Skin = SKIN) -> Recording:
    """States of other presses, asked for by channels (M, 4)."""
    metadata = METADATA | {"channels": channels.tolist(), "skin": skin.metadata()}
    return Recording(states(2, seed=9), None, None, None, metadata)


def simulated(asked: Recording, *items) -> np.ndarray:
    """(N, M): what the skin with effects reads by the query's channels."""
    chosen = settings(list(items), site_counts(CHANNELS), (0, 0))
    press = recording.presses(asked)
    return simulate(asked.frames, press, SKIN, asked.channels, chosen, frame_s=0.2)


def test_channels_in_another_order_and_some_of_them_are_predicted_the_same(gains, capsys):
    voltage, sd = predict(*gains, query(CHANNELS))
    some = np.random.default_rng(3).permutation(len(CHANNELS))[:25]
    there, spread = predict(*gains, query(CHANNELS[some]))
    assert np.allclose(there, voltage[:, some], rtol=1e-12, atol=0.0)
    assert np.allclose(spread, sd[:, some], rtol=1e-6, atol=0.0)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("drive", ["skip-2", "opposite"])
def test_other_drives_read_what_the_skin_does(contact, drive, capsys):
    asked = query(every_channel(8, drive, "skip-1"))
    voltage, _ = predict(*contact, asked)
    expected, without = simulated(asked, CONTACT), simulated(asked)
    assert np.abs(without - expected).max() > 1e-2 * np.abs(expected).max()
    assert np.abs(voltage - expected).max() < 0.05 * np.abs(without - expected).max()
    assert capsys.readouterr().err == ""


def test_a_drive_across_others_is_their_sum(contact):
    """By charge conservation, at driven electrodes too."""
    adjacent, _ = predict(*contact, query(EVERYWHERE))
    across, _ = predict(*contact, query(every_channel(8, "skip-2", "adjacent")))
    by_drive = adjacent.reshape(-1, 8, 8)
    summed = sum(np.roll(by_drive, -step, axis=1) for step in range(3))
    assert np.abs(across.reshape(summed.shape) - summed).max() < 1e-12 * np.abs(summed).max()


def test_a_new_pair_is_reciprocal(contact):
    ahead, sd = predict(*contact, query(SKIPPING))
    back, turned = predict(*contact, query(SKIPPING[:, [2, 3, 0, 1]]))
    assert np.abs(ahead - back).max() < 1e-12 * np.abs(ahead).max()
    assert np.allclose(sd, turned, rtol=1e-6)


def test_a_gain_stays_at_its_pair_and_is_not_taken_to_a_new_drive(gains, capsys):
    channels = np.concatenate([CHANNELS[5:9], SKIPPING])
    voltage, sd = predict(*gains, query(channels))
    said = capsys.readouterr().err
    assert "drive-gain: 32 channels (4: drive 0-3, measured 1-2, " in said
    assert "the recording has no such drive; std_V has its spread" in said and said.count("\n") == 1
    of_pair = simulated(query(channels), CONTACT, PAIRS)[:, 4:]
    own, own_sd = predict(*gains, query(CHANNELS[5:9]))
    assert np.allclose(voltage[:, :4], own, rtol=1e-12) and np.allclose(sd[:, :4], own_sd)
    assert np.abs(voltage[:, 4:] - of_pair).max() < 1e-4 * np.abs(of_pair).max()
    spread = 0.1 / np.sqrt(8) * np.abs(of_pair)
    assert (sd[:, 4:] > 0.999 * spread).all() and np.allclose(sd[:, 4:], spread, rtol=0.05)


def test_settings_of_the_same_channels_and_of_electrodes_stay_as_they_are():
    (contact, drive) = settings([CONTACT, DRIVE], site_counts(CHANNELS), (0, 0))
    assert mapped_setting(drive, CHANNELS, CHANNELS.copy()) is drive
    assert mapped_setting(contact, CHANNELS, SKIPPING) is contact
    assert not len(unmapped_channels(contact, CHANNELS, SKIPPING))
    assert np.array_equal(unmapped_channels(drive, CHANNELS, SKIPPING), np.arange(len(SKIPPING)))


@pytest.mark.parametrize("count", [4, 16])
def test_a_query_of_a_skin_with_other_electrodes_is_refused(contact, count, tmp_path):
    angles = tuple((np.arange(count) * 360.0 / count).tolist())
    asked = query(channel_table(count), replace(SKIN, electrode_deg=angles))
    recording.write(asked, tmp_path / "query.parquet")
    with pytest.raises(InputError, match=rf"found {count} electrodes, expected the recording's 8"):
        read_query(tmp_path / "query.parquet", contact[1])


def test_a_query_by_few_electrodes_of_unknown_place_is_read(contact, tmp_path):
    asked = query(np.array([[0, 1, 2, 3]]), replace(SKIN, electrode_deg=None))
    recording.write(asked, tmp_path / "query.parquet")
    assert len(read_query(tmp_path / "query.parquet", contact[1]).channels) == 1


def test_a_touched_query_of_a_skin_without_a_length_is_refused(tmp_path):
    touched = small_recording(places=1)
    recording.write(touched, tmp_path / "query.parquet")
    skin = {**touched.metadata["skin"], "radius_mm": None, "electrode_width_mm": None}
    skin["contact_impedivity_ohm_m2"] = None
    unsized = replace(touched, metadata={**touched.metadata, "skin": skin})
    untouched = of_frames(unsized, ~touched.frames["touch"].to_numpy(bool))
    with pytest.raises(InputError, match=r"query\.parquet.*touches.*skin\.radius_mm"):
        read_query(tmp_path / "query.parquet", untouched)
