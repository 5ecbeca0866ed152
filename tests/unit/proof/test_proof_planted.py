"""Faults planted in real recordings: exact, in the instrument's order, repeatable, judged."""

import warnings

import numpy as np
import pytest

from eitskin.data import importers, recording
from eitskin.data.recording import Recording, frames_table, validate
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from proof import judge, planted, real_sets
from shared_data import shared_data

LCT, HYDROGEL = "lct-tank/homogeneous", "hydrogel-skin/ohmc16.mat"
SKIN = {
    "radius_mm": 50.0,
    "thickness_mm": 3.0,
    "conductivity_S_per_m": 0.5,
    "electrode_deg": [0.0, 90.0, 180.0, 270.0],
    "electrode_width_mm": 5.0,
    "contact_impedivity_ohm_m2": 1e-3,
    "current_A": 1e-3,
    "contrast_per_N": 0.3,
}
# Every drive and every pair in one order, also those that share an electrode.
EVERY = [
    [a, b, p, m] for a in range(4) for b in range(a + 1, 4) for p in range(4) for m in range(p)
]


def small(frames: int = 3, touched=(), channels=None, readings=None, **metadata) -> Recording:
    """A recording of four electrodes, its readings 1, 2, 3, ..."""
    channels = channels or [[0, 1, 2, 3], [1, 2, 3, 0], [2, 3, 0, 1], [3, 0, 1, 2]]
    touch = np.isin(np.arange(frames), touched)
    if readings is None:
        readings = np.tile(1.0 + np.arange(len(channels)), (frames, 1))
    given = {
        **recording.DEFAULTS,
        "format": "eit-recording",
        "version": 1,
        "channels": channels,
        "voltage": "signed",
        "frame_s": 0.4,
        "position_frame": "skin",
        "source": "a test",
        "skin": SKIN,
    }
    table = frames_table(np.arange(frames), touch, 0.0, 0.0, 1.0, 10.0)
    return Recording(table, readings, None, None, given | metadata)


def written(tmp_path, recorded: Recording) -> dict:
    path = tmp_path / "own.parquet"
    recording.write(recorded, path)
    return {"own": path}


def test_planted_in_the_instruments_order():
    faults = [
        {"name": "lost-channels", "channels": [3]},
        {"name": "adc-nonlinearity", "parameters": {"limit_V": 12.0}},
        {"name": "offset", "measures": [2], "parameters": {"volt": [1.0]}},
        {"name": "drive-gain", "drives": [0, 1], "parameters": {"gain": [3.0, 10.0]}},
    ]
    read = planted.plant(small(), faults)
    assert np.array_equal(read[0], [1.0 * 3.0 + 1.0, 12.0, 3.0, np.nan], equal_nan=True)


def test_exchanged_wires_read_what_they_then_touch():
    rng = np.random.default_rng(1)
    level = rng.standard_normal((4, 4))
    level = level + level.T

    def reading(channels, wires) -> np.ndarray:
        at = np.array(wires)[np.array(channels)].T
        source, sink, plus, minus = at
        return (level[source, plus] - level[sink, plus]) - (
            level[source, minus] - level[sink, minus]
        )

    recorded = small(1, channels=EVERY, readings=reading(EVERY, range(4))[None])
    for a, b in planted.swaps(recorded.channels):
        wires = np.arange(4)
        wires[[a, b]] = b, a
        swapped = planted.plant(recorded, [{"name": "electrode-swap", "electrodes": [a, b]}])
        assert swapped[0] == pytest.approx(reading(EVERY, wires))
    assert len(planted.swaps(recorded.channels)) == 6


@pytest.mark.parametrize("drive", ["adjacent", "opposite"])
@pytest.mark.parametrize("n", [8, 16])
def test_adjacent_measurement_allows_no_exact_exchange(n, drive):
    assert planted.swaps(channel_table(n, drive)) == []


def test_only_what_is_exact():
    signed = small()
    assert all(planted.can_plant(signed, fault) for fault in planted.FAULTS)
    assert planted.swaps(signed.channels) == [(0, 2), (1, 3)]  # mirrors of a ring of four
    magnitude = small(voltage="magnitude")
    assert not any(planted.can_plant(magnitude, fault) for fault in planted.SIGNED)
    assert planted.can_plant(magnitude, "clipping") and planted.can_plant(magnitude, "drive-gain")
    by_order = small(clock="index")
    assert not planted.can_plant(by_order, "mains-interference")
    difference = small(values="difference")
    assert not any(
        planted.can_plant(difference, fault) for fault in (planted.NONE, *planted.FAULTS)
    )
    lost = small()
    lost.voltage[0, 0] = np.nan
    assert not planted.can_plant(lost, "multiplexer-memory") and planted.can_plant(lost, "offset")
    with pytest.raises(InputError, match="fault"):
        planted.can_plant(signed, "rust")


def test_excerpts_keep_presses_whole(tmp_path):
    touched = [row for row in range(400) if row % 8 > 2]
    rng = np.random.default_rng(2)
    voltage = 1.0 + rng.standard_normal((400, 4)) ** 2
    paths = written(tmp_path, small(400, touched, readings=voltage))
    starts = set()
    for seed in range(12):
        case = planted.draw("real:own:none", seed, paths)
        assert 90 <= len(case.states) <= 150
        touch = case.states["touch"].to_numpy()
        runs = np.flatnonzero(np.diff(np.concatenate([[0], touch, [0]]).astype(int)))
        assert set(np.diff(runs)[::2]) == {5}
        assert case.states["time_s"].iloc[0] == 0.0 and not case.query["touch"].any()
        assert case.query["time_s"].iloc[0] > case.states["time_s"].iloc[-1] or len(case.query) == 1
        first = np.flatnonzero((voltage == case.voltage[0]).all(axis=1))
        assert np.array_equal(case.voltage, voltage[first[0] : first[0] + len(touch)])
        starts.add(int(first[0]))
    assert len(starts) > 6


def test_faults_beside_channels_that_the_owner_lost(tmp_path):
    rng = np.random.default_rng(3)
    readings = 1.0 + 1e-3 * rng.standard_normal((40, 4)) + np.arange(4)
    readings[:, 2] = np.nan
    paths = written(tmp_path, small(40, range(20, 30), readings=readings))
    case = planted.draw("real:own:drive-gain", 4, paths)
    assert np.isnan(case.voltage[:, 2]).all() and np.isfinite(case.voltage[:, [0, 1, 3]]).all()
    assert 7.5 <= case.snr[0] <= 42.0 and case.fault["drives"] != [2]


def said(*effects) -> dict:
    sites = {kind: [] for kind in ("electrodes", "drives", "measures", "channels")}
    empty = {**sites, "alternatives": [], "parameters": {}}
    return {"effects": [{**empty, **effect} for effect in effects]}


def test_found_where_named_at_its_sites_and_not_in_the_control():
    fault = {"name": "drive-gain", "drives": [3], "parameters": {"gain": [1.1]}}
    right, wrong = said({"name": "drive-gain", "drives": [3]}), said({"name": "drive-gain"})
    as_class = said({"name": "offset", "alternatives": ["drive-gain"], "drives": [3]})
    assert judge.finds_fault(right, said(), fault) and judge.finds_fault(right, wrong, fault)
    assert judge.finds_fault(as_class, said(), fault)
    assert not judge.finds_fault(wrong, said(), fault)
    assert not judge.finds_fault(right, right, fault)
    assert not judge.finds_fault(said({"name": "offset", "drives": [3]}), said(), fault)


def test_clipping_is_not_a_cubic():
    fault = {"name": "adc-nonlinearity", "parameters": {"limit_V": 1.0}}
    clipped = said({"name": "adc-nonlinearity", "parameters": {"limit_V": {}}})
    cubic = said({"name": "adc-nonlinearity", "parameters": {"cubic": {}}})
    assert judge.finds_fault(clipped, said(), fault) and judge.finds_fault(clipped, cubic, fault)
    assert not judge.finds_fault(cubic, said(), fault)


def test_lost_channels_are_borne_where_nothing_new_is_named():
    fault = {"name": "lost-channels", "channels": [1]}
    there = {"name": "drive-gain", "drives": [3]}
    assert judge.finds_fault(said(there), said(there), fault) and judge.finds_fault(
        said(), said(there), fault
    )
    assert not judge.finds_fault(said(there, {"name": "offset"}), said(there), fault)


@pytest.mark.parametrize("kind", ["real:own:rust", "real:other:none", "null", "real:none"])
def test_refuses_unknown_kinds(kind, tmp_path):
    with pytest.raises(InputError):
        planted.draw(kind, 1, written(tmp_path, small()))


def test_absent_sets_are_said_so(monkeypatch, tmp_path):
    monkeypatch.setenv("EITSKIN_DATA", str(tmp_path))
    with pytest.warns(UserWarning, match="SKIPPED.*lct-tank"):
        assert real_sets.present() == {}
    with pytest.warns(UserWarning), pytest.raises(InputError, match="none"):
        planted.draw("real:lct-tank:none", 1)


def test_every_fault_of_a_tank():
    paths = {"lct-tank": shared_data(LCT)}
    control = planted.draw("real:lct-tank:none", 5, paths)
    source = importers.load(paths["lct-tank"])
    assert np.array_equal(control.voltage, source.voltage)
    assert control.fault is None and control.effects == [] and control.metadata["frame_s"] == 0.3
    for kind in planted.kinds(paths)[1:]:
        case = planted.draw(kind, 5, paths)
        again = planted.draw(kind, 5, paths)
        assert np.array_equal(case.voltage, again.voltage, equal_nan=True)
        assert case.states.equals(control.states) and case.metadata == control.metadata
        changed = ~(case.voltage == control.voltage)
        assert changed.any(), kind
        if "channels" in case.fault:
            assert np.flatnonzero(changed.any(axis=0)).tolist() == case.fault["channels"]
        if case.effects:
            assert 7.5 <= case.snr[0] <= 42.0, kind
        made = Recording(case.states, case.voltage, None, None, dict(case.metadata))
        validate(made, kind)
    assert len(planted.kinds(paths)) == len(planted.FAULTS)  # none beside, no exchange of wires


def test_a_stretch_of_the_hydrogel_skin():
    paths = {"hydrogel": shared_data(HYDROGEL)}
    faults = {kind.split(":")[2] for kind in planted.kinds(paths)}
    assert faults == {planted.NONE, *planted.GAINS, "clipping", "lost-channels"}
    control, harmed = (planted.draw(f"real:hydrogel:{f}", 3, paths) for f in ("none", "drive-gain"))
    assert 100 <= len(control.states) <= 150
    ratio = harmed.voltage / control.voltage
    driven = np.isin(np.array(control.metadata["channels"])[:, 0], harmed.fault["drives"])
    assert ratio[:, ~driven] == pytest.approx(1.0) and (ratio[:, driven] != 1.0).all()
    validate(Recording(harmed.states, harmed.voltage, None, None, harmed.metadata), "harmed")


def test_no_warning_where_all_sets_are_there(monkeypatch):
    monkeypatch.setenv("EITSKIN_DATA", str(shared_data("lct-tank").parent))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "lct-tank" in real_sets.present()
