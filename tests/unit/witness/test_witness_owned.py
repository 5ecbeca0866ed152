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
    owned_recording, repeated, other_seed = of(kind, PRESSED), of(kind, PRESSED), of(kind, STILL)
    assert np.array_equal(owned_recording.voltage, repeated.voltage, equal_nan=True)
    assert np.array_equal(owned_recording.query.voltage, repeated.query.voltage)
    pd.testing.assert_frame_equal(owned_recording.recorded.frames, repeated.recorded.frames)
    assert owned_recording.recorded.metadata == repeated.recorded.metadata
    assert (
        owned_recording.truth == repeated.truth
        and owned_recording.drawn == repeated.drawn
        and owned_recording.rig == repeated.rig
    )
    assert owned_recording.voltage.shape != other_seed.voltage.shape


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
@pytest.mark.parametrize("kind", QUICK)
def test_a_recording_is_one_that_can_be_read(kind, seeds):
    owned_recording = of(kind, seeds)
    recording.validate(owned_recording.recorded, kind)
    touched = seeds is PRESSED
    assert (
        owned_recording.recorded.frames["touch"].any() == touched
        and (owned_recording.query is not None) == touched
    )
    assert 2.9e-4 < owned_recording.level <= 5e-3 and len(owned_recording.rig) <= 2
    if touched:
        recording.validate(owned_recording.query, kind)
        end_s = owned_recording.recorded.frames["time_s"].iloc[-1]
        assert owned_recording.query.frames["time_s"].min() > end_s
    else:
        assert (
            20 <= len(owned_recording.voltage) <= 60
            and np.ptp(owned_recording.clean[:10], axis=0).max() < 1e-12
        )


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
def test_driven_channels_pile_up_at_the_ceiling_and_no_others(seeds):
    owned_recording = of("clipped", seeds)
    ceiling, free = owned_recording.truth.ceiling_V, undriven(owned_recording.recorded.channels)
    noise = owned_recording.level * np.median(np.abs(owned_recording.clean[0]))
    stopped = (np.abs(owned_recording.clean) > ceiling + 4.0 * noise).all(axis=0)
    assert not stopped[free].any() and stopped.sum() in (16, 48) and (~free).sum() == 48
    distance_V = np.abs(np.abs(owned_recording.voltage[:, stopped]) - ceiling)
    assert np.nanmax(distance_V) < 0.6 * noise
    below = np.nanmax(np.abs(owned_recording.voltage[:, free]))
    assert below < ceiling
    assert (
        np.abs(owned_recording.query.voltage).max() < ceiling + 0.6 * noise
        if seeds is PRESSED
        else True
    )


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
def test_a_step_is_where_the_truth_says(seeds):
    owned_recording = of("step", seeds)
    step, count = owned_recording.truth.step, len(owned_recording.clean)
    assert 0.2 * count < step < 0.8 * count
    world = World(
        owned_recording.true,
        owned_recording.recorded.channels,
        owned_recording.recorded.metadata["frame_s"],
    )
    frames = owned_recording.recorded.frames
    plain, stepped = (world.readings(frames, laws) for laws in ([], owned_recording.truth.effects))
    assert np.array_equal(owned_recording.clean[:step], plain[:step])
    assert np.array_equal(owned_recording.clean[step:], stepped[step:])
    noise = owned_recording.level * np.median(np.abs(plain[0]))
    assert np.linalg.norm(stepped[step] - plain[step]) > 0.99 * owned.MIN_STEP_SNR * noise


def test_readings_after_a_step_are_those_of_the_changed_skin():
    owned_recording = of("step", PRESSED)
    world = World(
        owned_recording.true,
        owned_recording.recorded.channels,
        owned_recording.recorded.metadata["frame_s"],
    )
    largest = owned_recording.recorded.frames["force_N"].max()
    noise = owned_recording.level * np.median(np.abs(owned_recording.clean[0]))
    deviations = [
        owned_recording.query.voltage
        - world.readings(owned_recording.query.frames, laws, None, largest)
        for laws in (owned_recording.truth.effects, [])
    ]
    assert np.sqrt((deviations[0] ** 2).mean()) == pytest.approx(noise, rel=0.1)
    assert np.sqrt((deviations[1] ** 2).mean()) > 1.5 * noise


def concealed_snr(owned_recording):
    """SNR of what a recording conceals, beyond what its owner does not know."""
    world = World(
        owned_recording.true,
        owned_recording.recorded.channels,
        owned_recording.recorded.metadata["frame_s"],
    )
    noise = (
        owned_recording.level
        * np.median(np.abs(owned_recording.clean[0]))
        * np.ones(owned_recording.clean.shape[1])
    )
    frames = owned_recording.recorded.frames
    return owned.snr_beyond_sheet(
        owned_recording.true,
        owned_recording.recorded.skin,
        world,
        frames,
        owned_recording.clean,
        noise,
    )


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
def test_what_is_out_of_round_is_seen(seeds):
    owned_recording = of("out-of-round", seeds)
    assert concealed_snr(
        owned_recording
    ) > 0.99 * owned.MIN_SNR and owned_recording.truth.wanted == ("domain-shape",)


def test_worse_contacts_are_nothing_beyond_where_their_owner_does_not_know_them():
    owned_recording = draw("owner:polarity", 1)
    world = World(owned_recording.true, owned_recording.recorded.channels, 1.0)
    frames = owned_recording.recorded.frames
    noise = 1e-4 * np.abs(owned_recording.clean[0]).max() * np.ones(208)
    worse = {"name": "contact-impedance", "parameters": {"ratio": 2.0}}
    clean = world.readings(frames, [worse])
    unknown = replace(owned_recording.true, contact_impedivity_ohm_m2=None)
    snr = [
        owned.snr_beyond_sheet(owned_recording.true, b, world, frames, clean, noise)
        for b in (owned_recording.true, unknown)
    ]
    assert snr[0] > 20.0 * snr[1]


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
    owned_recording = of("order", seeds)
    channels = owned_recording.recorded.channels
    assert owned_recording.truth.wrong == "order"
    assert reciprocity(owned_recording.voltage, channels) > 0.25
    assert reciprocity(owned_recording.clean, channels) < 1e-6
    way = next(order for name, order in owned.ORDERS.items() if name in owned_recording.drawn)
    put_right = np.empty_like(owned_recording.voltage)
    put_right[:, way(channels)] = owned_recording.voltage
    assert reciprocity(put_right, channels) < 0.02


@pytest.mark.parametrize("way", owned.ORDERS)
def test_every_order_is_another(way):
    channels = of("order", STILL).recorded.channels
    order = owned.ORDERS[way](channels)
    assert sorted(order) == list(range(len(channels)))
    assert (order != np.arange(len(channels))).mean() > 0.5


def test_exchanged_plus_and_minus_turn_the_sign():
    owned_recording = of("polarity", STILL)
    along = (owned_recording.voltage * owned_recording.clean).sum() / (
        owned_recording.clean**2
    ).sum()
    assert along == pytest.approx(-1.0, abs=0.01) and owned_recording.truth.wrong == "polarity"


@pytest.mark.parametrize("seeds", [STILL, PRESSED])
def test_some_beliefs_are_missing(seeds):
    owned_recording = of("beliefs", seeds)
    unknown = [key for key in owned.UNKNOWN if getattr(owned_recording.recorded.skin, key) is None]
    assert unknown and all(key in owned_recording.drawn or "contact" in key for key in unknown)


@pytest.fixture(scope="module")
def planned():
    """Plans of the kinds that are slow to solve, not solved."""
    return {
        kind: [owned.KINDS[kind](np.random.default_rng(seed)) for seed in range(60)]
        for kind in ("static-body", "many-drives")
    }


def test_bodies_conceal_their_depth_where_electrodes_are_lower(planned):
    knowledge = set()
    for plan in planned["static-body"]:
        low = plan.true.electrode_height_mm < plan.true.thickness_mm
        assert plan.truth.wanted == (("third-dimension",) if low else ())
        believed = plan.believed
        knowledge.add((believed.thickness_mm is None, believed.electrode_height_mm is None))
        for law in plan.laws:
            assert law["parameters"] == {} or believed.thickness_mm is None
        half = 0.5 * plan.true.electrode_height_mm
        top = plan.true.electrode_z_mm + half
        assert plan.true.electrode_z_mm >= half - 1e-9
        assert top <= plan.true.thickness_mm + 1e-9
    assert knowledge == {(False, False), (False, True), (True, True)}


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
    owned_recording = draw(f"owner:{kind}", seed)
    assert owned_recording.truth.wanted == ("third-dimension",)
    assert concealed_snr(owned_recording) > 0.99 * owned.MIN_SNR
    assert reciprocity(owned_recording.clean, owned_recording.recorded.channels) < 1e-4


@pytest.mark.parametrize("kind", ["static-body", "owner:nothing", "query:rig"])
def test_an_unknown_kind_is_refused(kind):
    with pytest.raises(InputError, match="owned: kind"):
        draw(kind, 1)
