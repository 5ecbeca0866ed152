"""Recordings as owners have them: repeatable, and what each conceals is really there."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from eitskin.data import recording
from eitskin.errors import InputError
from eitskin.physics.protocol import reciprocal_channels, undriven
from witness import owned
from witness.owned import carried, draw
from witness.world import World

QUICK = {  # kind: a seed whose bodies are soon solved, untouched and touched
    "out-of-round": (1, 2),
    "clipped": (5, 1),
    "step": (2, 1),
    "order": (1, 2),
    "polarity": (1, 4),
    "beliefs": (3, 1),
}
STILL = {kind: seeds[0] for kind, seeds in QUICK.items()}
PRESSED = {kind: seeds[1] for kind, seeds in QUICK.items()}


def of(kind, seeds):
    return draw(f"owner:{kind}", seeds[kind])


def reciprocity(voltage, channels):
    """rms of what exchanging drive and measurement changes in the mean frame, over its rms."""
    pairs, sign = reciprocal_channels(channels)
    mean = voltage.mean(axis=0)
    return np.sqrt(np.mean((mean[pairs[:, 1]] - sign * mean[pairs[:, 0]]) ** 2) / np.mean(mean**2))


@pytest.mark.parametrize("kind", QUICK)
def test_equal_seeds_give_equal_bits(kind):
    one, again, other = of(kind, PRESSED), of(kind, PRESSED), of(kind, STILL)
    assert np.array_equal(one.voltage, again.voltage, equal_nan=True)
    assert np.array_equal(one.query.voltage, again.query.voltage)
    pd.testing.assert_frame_equal(one.recorded.frames, again.recorded.frames)
    assert one.recorded.metadata == again.recorded.metadata
    assert one.truth == again.truth and one.drawn == again.drawn and one.rig == again.rig
    assert one.voltage.shape != other.voltage.shape


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
@pytest.mark.parametrize("kind", QUICK)
def test_a_recording_is_one_that_can_be_read(kind, seeds):
    one = of(kind, seeds)
    recording.validate(one.recorded, kind)
    touched = seeds is PRESSED
    assert one.recorded.frames["touch"].any() == touched and (one.query is not None) == touched
    assert 2.9e-4 < one.level <= 5e-3 and len(one.rig) <= 2
    if touched:
        recording.validate(one.query, kind)
        last = one.recorded.frames["time_s"].iloc[-1]
        assert one.query.frames["time_s"].min() > last
    else:
        assert 20 <= len(one.voltage) <= 60 and np.ptp(one.clean[:10], axis=0).max() < 1e-12


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
def test_driven_channels_pile_up_at_the_ceiling_and_no_others(seeds):
    one = of("clipped", seeds)
    ceiling, free = one.truth.ceiling_V, undriven(one.recorded.channels)
    noise = one.level * np.median(np.abs(one.clean[0]))
    stopped = (np.abs(one.clean) > ceiling + 4.0 * noise).all(axis=0)
    assert not stopped[free].any() and stopped.sum() in (16, 48) and (~free).sum() == 48
    near = np.abs(np.abs(one.voltage[:, stopped]) - ceiling)
    assert np.nanmax(near) < 0.6 * noise
    below = np.nanmax(np.abs(one.voltage[:, free]))
    assert below < ceiling
    assert np.abs(one.query.voltage).max() < ceiling + 0.6 * noise if seeds is PRESSED else True


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
def test_a_step_is_where_the_truth_says(seeds):
    one = of("step", seeds)
    step, count = one.truth.step, len(one.clean)
    assert 0.2 * count < step < 0.8 * count
    world = World(one.true, one.recorded.channels, one.recorded.metadata["frame_s"])
    frames = one.recorded.frames
    before, after = (world.readings(frames, laws) for laws in ([], one.truth.effects))
    assert np.array_equal(one.clean[:step], before[:step])
    assert np.array_equal(one.clean[step:], after[step:])
    noise = one.level * np.median(np.abs(before[0]))
    assert np.linalg.norm(after[step] - before[step]) > 0.99 * owned.MIN_STEP_SNR * noise


def test_readings_after_a_step_are_those_of_the_changed_skin():
    one = of("step", PRESSED)
    world = World(one.true, one.recorded.channels, one.recorded.metadata["frame_s"])
    largest = one.recorded.frames["force_N"].max()
    noise = one.level * np.median(np.abs(one.clean[0]))
    off = [
        one.query.voltage - world.readings(one.query.frames, laws, None, largest)
        for laws in (one.truth.effects, [])
    ]
    assert np.sqrt((off[0] ** 2).mean()) == pytest.approx(noise, rel=0.1)
    assert np.sqrt((off[1] ** 2).mean()) > 1.5 * noise


def left(one):
    """SNR of what a recording conceals, beyond what its owner does not know."""
    world = World(one.true, one.recorded.channels, one.recorded.metadata["frame_s"])
    noise = one.level * np.median(np.abs(one.clean[0])) * np.ones(one.clean.shape[1])
    frames = one.recorded.frames
    return owned.snr_beyond_sheet(one.true, one.recorded.skin, world, frames, one.clean, noise)


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
def test_what_is_out_of_round_is_seen(seeds):
    one = of("out-of-round", seeds)
    assert left(one) > 0.99 * owned.MIN_SNR and one.truth.wanted == ("domain-shape",)


def test_worse_contacts_are_nothing_beyond_where_their_owner_does_not_know_them():
    one = draw("owner:polarity", 1)
    world = World(one.true, one.recorded.channels, 1.0)
    frames, noise = one.recorded.frames, 1e-4 * np.abs(one.clean[0]).max() * np.ones(208)
    worse = {"name": "contact-impedance", "parameters": {"ratio": 2.0}}
    clean = world.readings(frames, [worse])
    unknown = replace(one.true, contact_impedivity_ohm_m2=None)
    seen = [
        owned.snr_beyond_sheet(one.true, b, world, frames, clean, noise)
        for b in (one.true, unknown)
    ]
    assert seen[0] > 20.0 * seen[1]


@pytest.mark.parametrize("harmonic", [2, 3])
def test_carried_electrodes_keep_their_arc_length(harmonic):
    deg, amplitude, phase = tuple(360.0 / 16 * np.arange(16)), 0.08, 33.0
    phi = np.radians(np.array(deg) + carried(deg, harmonic, amplitude, phase))
    lengths = []
    for low, high in zip(phi, np.append(phi[1:], phi[0] + 2.0 * np.pi), strict=True):
        t = np.linspace(low, high, 2001)
        r = 1.0 + amplitude * np.cos(harmonic * t - np.radians(phase))
        lengths.append(np.abs(np.diff(r * np.exp(1j * t))).sum())
    assert np.ptp(lengths) < 1e-4 * np.mean(lengths)
    first_order = -amplitude / harmonic * np.sin(harmonic * np.radians(deg) - np.radians(phase))
    shift = np.radians(carried(deg, harmonic, 1e-3, phase))
    assert np.allclose(shift, first_order * 1e-3 / amplitude, atol=3e-6)


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
def test_a_wrong_order_breaks_reciprocity_and_a_right_one_does_not(seeds):
    one = of("order", seeds)
    channels = one.recorded.channels
    assert one.truth.wrong == "order"
    assert reciprocity(one.voltage, channels) > 0.25
    assert reciprocity(one.clean, channels) < 1e-6
    way = next(order for name, order in owned.ORDERS.items() if name in one.drawn)
    put_right = np.empty_like(one.voltage)
    put_right[:, way(channels)] = one.voltage
    assert reciprocity(put_right, channels) < 0.02


@pytest.mark.parametrize("way", owned.ORDERS)
def test_every_order_is_another(way):
    channels = of("order", STILL).recorded.channels
    order = owned.ORDERS[way](channels)
    assert sorted(order) == list(range(len(channels)))
    assert (order != np.arange(len(channels))).mean() > 0.5


def test_exchanged_plus_and_minus_turn_the_sign():
    one = of("polarity", STILL)
    along = (one.voltage * one.clean).sum() / (one.clean**2).sum()
    assert along == pytest.approx(-1.0, abs=0.01) and one.truth.wrong == "polarity"


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
def test_some_beliefs_are_missing(seeds):
    one = of("beliefs", seeds)
    unknown = [key for key in owned.UNKNOWN if getattr(one.recorded.skin, key) is None]
    assert unknown and all(key in one.drawn or "contact" in key for key in unknown)


@pytest.fixture(scope="module")
def planned():
    """Plans of the kinds that are slow to solve, not solved."""
    return {
        kind: [owned.KINDS[kind](np.random.default_rng(seed)) for seed in range(60)]
        for kind in ("static-body", "many-drives")
    }


def test_bodies_conceal_their_depth_where_electrodes_are_lower(planned):
    said = set()
    for plan in planned["static-body"]:
        low = plan.true.electrode_height_mm < plan.true.thickness_mm
        assert plan.truth.wanted == (("third-dimension",) if low else ())
        believed = plan.believed
        said.add((believed.thickness_mm is None, believed.electrode_height_mm is None))
        for law in plan.laws:
            assert law["parameters"] == {} or believed.thickness_mm is None
        half = 0.5 * plan.true.electrode_height_mm
        top = plan.true.electrode_z_mm + half
        assert plan.true.electrode_z_mm >= half - 1e-9
        assert top <= plan.true.thickness_mm + 1e-9
    assert said == {(False, False), (False, True), (True, True)}


def test_many_drives_are_many(planned):
    sizes = {(len(p.true.electrode_deg), len(p.channels)) for p in planned["many-drives"]}
    assert sizes == {(32, 928), (32, 896), (16, 784), (16, 400)}
    for plan in planned["many-drives"]:
        assert len({tuple(row) for row in plan.channels.tolist()}) == len(plan.channels)
        pitch = 2.0 * np.pi * plan.true.radius_mm / len(plan.true.electrode_deg)
        assert plan.true.electrode_width_mm <= 0.4 * pitch * 1.001
    assert {len(plan.truth.effects) for plan in planned["many-drives"]} == {0, 1}


@pytest.mark.long
@pytest.mark.parametrize(("kind", "seed"), [("static-body", 2), ("many-drives", 4)])
def test_a_body_is_not_the_sheet_that_its_owner_simulates(kind, seed):
    one = draw(f"owner:{kind}", seed)
    assert one.truth.wanted == ("third-dimension",)
    assert left(one) > 0.99 * owned.MIN_SNR
    assert reciprocity(one.clean, one.recorded.channels) < 1e-4


@pytest.mark.parametrize("kind", ["static-body", "owner:nothing", "query:rig"])
def test_an_unknown_kind_is_refused(kind):
    with pytest.raises(InputError, match="owned: kind"):
        draw(kind, 1)
