"""Two recordings of one skin: what changed is found without a model of the skin."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin import cli
from eitskin.data import recording
from eitskin.data.importers.description import describe
from eitskin.data.recording import Recording, frames_table
from eitskin.diagnose.compare import faults
from eitskin.diagnose.compare.difference import Finding, difference
from eitskin.diagnose.compare.evidence import Explanation
from eitskin.diagnose.compare.potentials import Potentials
from eitskin.diagnose.compare.result import comparison
from eitskin.diagnose.compare.wander import wander
from eitskin.diagnose.compare.words import sentences
from eitskin.errors import InputError
from eitskin.physics.forward import channel_values
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table
from proof import planted

NAMES = ("monday", "friday")
N = 16
ADJACENT = channel_table(N)
PATTERNS = {
    "adjacent": ADJACENT,
    "opposite": channel_table(N, "opposite"),
    "skip-2": channel_table(N, "skip-2", "skip-2"),
}


def impedances(seed: int, n: int = N) -> np.ndarray:
    """(n, n): of some passive network on a ring: near electrodes see more of each other."""
    draw = np.random.default_rng(seed)
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    ring = np.minimum(apart, n - apart)
    wild = draw.normal(size=(n, n))
    return np.exp(-ring / 4.0) + 0.02 * (wild + wild.T)


def session(seed: int, channels: np.ndarray = ADJACENT, count: int = 30, **changed) -> Recording:
    """Untouched frames of the network of seed 0: its noise, a drift of one direction, nothing else.
    changed: `wires` (n,), `voltage`, `frame_s`."""
    draw = np.random.default_rng(seed)
    wires = changed.get("wires", np.arange(N))
    plain = channel_values(impedances(0), wires[channels])
    drift = np.cumsum(draw.normal(0.0, 0.2, count)) + 0.3 * draw.normal()
    noise = 1e-4 * np.median(np.abs(plain))
    wandering = channel_values(impedances(1), channels)
    wandering *= noise / np.std(wandering)
    readings = plain + drift[:, None] * wandering + noise * draw.normal(size=(count, len(plain)))
    kind = changed.get("voltage", "signed")
    metadata = describe(channels, even_angles(N), "simulation", kind, clock="measured")
    metadata["frame_s"] = changed.get("frame_s")
    metadata["skin"]["electrode_deg"] = None  # nobody needs to know
    still = frames_table(np.arange(count) * 0.5, np.zeros(count, bool))
    return Recording(
        still, np.abs(readings) if kind == "magnitude" else readings, None, None, metadata
    )


def explained(evidence: float) -> Explanation:
    """One fault with its evidence."""
    return Explanation((faults.Signature("offset", "channels", (3,), np.ones((4, 1))),), evidence)


def test_a_fault_is_named_from_ten_nats_above_the_best_at_another_site():
    for margin, is_named in ((2.5, False), (9.9, False), (10.0, True)):
        rival = explained(100.0 - margin)
        finding = Finding(explained(100.0), rival, (), 0, np.ones(4), 1.0)
        assert finding.named == is_named
    assert Finding(explained(100.0), None, (), 0, np.ones(4), 1.0).named


def named(control: Recording, later: Recording) -> list[tuple]:
    """Names and places that are given."""
    findings = difference(control, later, NAMES).findings
    return [(one.name, one.explanation.place) for one in findings if one.named]


@pytest.mark.parametrize("pattern", PATTERNS)
def test_without_a_fault_nothing_is_named(pattern):
    for seed in range(4):
        pair = [session(10 * seed + i + 1, PATTERNS[pattern]) for i in (0, 1)]
        assert difference(*pair, NAMES).findings == []


FAULTS = {
    "drive": {"name": "drive-gain", "drives": [3], "parameters": {"gain": [1.003]}},
    "two drives": {"name": "drive-gain", "drives": [3, 9], "parameters": {"gain": [1.003, 1.002]}},
    "pair": {"name": "measurement-gain", "measures": [5], "parameters": {"gain": [0.997]}},
    "channel": {"name": "channel-gain", "channels": [40], "parameters": {"gain": [1.01]}},
    "offset": {"name": "offset", "measures": [7], "parameters": {"volt": [1e-3]}},
    "crosstalk": {"name": "crosstalk", "parameters": {"epsilon": 0.001}},
    "memory": {"name": "multiplexer-memory", "parameters": {"mu": 0.001}},
}


@pytest.mark.parametrize("pattern", ["adjacent", "skip-2"])
@pytest.mark.parametrize("which", FAULTS)
def test_a_fault_is_found_at_its_site(which, pattern):
    fault = FAULTS[which]
    control, later = (session(seed, PATTERNS[pattern]) for seed in (1, 2))
    later = replace(later, voltage=planted.plant(later, [fault]))
    kind = next((k for k in ("drives", "measures", "channels") if k in fault), None)
    assert named(control, later) == [(fault["name"], (kind, tuple(fault.get(kind, ()))))]


@given(st.integers(0, 5), st.floats(1e-4, 2e-3), st.sampled_from(sorted(FAULTS)))
@settings(max_examples=20, deadline=None)
def test_signatures_are_what_is_planted(seed, size, which):
    """A planted fault of any size lies in its signature's span; memory to first order."""
    fault = json.loads(json.dumps(FAULTS[which]))
    for key, value in fault["parameters"].items():
        step = size * (1 + np.arange(np.size(value)))
        fault["parameters"][key] = (1.0 + step if key == "gain" else step).tolist()
        if np.ndim(value) == 0:
            fault["parameters"][key] = float(step[0])
    still = session(seed + 1, count=1)
    change = (planted.plant(still, [fault]) - still.voltage)[0]
    whole = Potentials(ADJACENT, N, np.ones(len(ADJACENT), bool))
    control = faults.Control(whole, still.voltage[0], True)
    all_ = [s for family in faults.families(control) for s in family]
    all_ += faults.siteless(control)
    kind = next((k for k in ("drives", "measures", "channels") if k in fault), None)
    own = [
        s.basis
        for s in all_
        if s.name == fault["name"] and s.kind == kind and set(s.sites) <= set(fault.get(kind, ()))
    ]
    basis = np.column_stack(own)
    left = change - basis @ np.linalg.lstsq(basis, change, rcond=None)[0]
    first_order = 3 * size if which == "memory" else 1e-9
    assert np.linalg.norm(left) <= first_order * np.linalg.norm(change)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_crossed_wires_read_sums_of_what_was_read(pattern):
    """What is said to follow from the readings does, in every pattern. With opposite drive an
    exchange over half of the rim moves every channel of theirs to one that nobody read."""
    channels = PATTERNS[pattern]
    z = impedances(3)
    z = z + 0.1 * np.random.default_rng(0).normal(size=z.shape)  # reciprocity is not used
    values = channel_values(z, channels)
    potentials = Potentials(channels, N, np.ones(len(channels), bool))
    assert channel_values(potentials.impedances(values).T, channels) == pytest.approx(values)
    for a, b in ((0, 1), (2, 5), (2, 9)):
        wires = np.arange(N)
        wires[[a, b]] = b, a
        read, known = potentials.exchanged(potentials.impedances(values), a, b)
        assert read[known] == pytest.approx(channel_values(z, wires[channels])[known], abs=1e-9)
        unmoved = ~np.isin(channels, (a, b)).any(axis=1)
        assert known[unmoved].all()
        assert known.sum() > unmoved.sum() or (pattern, a, b) == ("opposite", 2, 9)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_exchanged_wires_are_found(pattern):
    wires = np.arange(N)
    wires[[4, 9]] = 9, 4
    control, later = (session(1, PATTERNS[pattern]), session(2, PATTERNS[pattern], wires=wires))
    assert named(control, later)[:1] == [("electrode-swap", ("electrodes", (4, 9)))]


def test_magnitudes_show_gains_and_exchanged_wires():
    opposite = PATTERNS["opposite"]
    control, later = (session(seed, opposite, voltage="magnitude") for seed in (1, 2))
    harmed = planted.plant(later, [FAULTS["drive"]])
    assert named(control, replace(later, voltage=harmed)) == [("drive-gain", ("drives", (3,)))]


def test_a_dead_channel_and_a_lost_one():
    control, later = session(1), session(2)
    voltage = later.voltage.copy()
    voltage[:, 17] = 0.0
    voltage[:, 30] = np.nan
    found = difference(control, replace(later, voltage=voltage), NAMES)
    assert found.lost_channels == (30,)
    assert [one.explanation.place for one in found.findings] == [("channels", (17,))]
    said = comparison(control, replace(later, voltage=voltage), NAMES)["sentences"]
    assert "friday has no readings of channel 30" in said[0] and "it is dead" in said[1]


def test_clipped_readings():
    control, later = session(1), session(2)
    limit = 0.97 * np.abs(later.voltage).max()
    clipped = replace(later, voltage=np.clip(later.voltage, -limit, limit))
    assert named(control, clipped) == [("adc-nonlinearity", (None, ()))]


def test_the_mains_are_found_where_they_turn_from_frame_to_frame():
    control, later = (session(seed, frame_s=0.3) for seed in (1, 2))
    noise = wander(control.voltage, later.voltage).noise.mean()
    mains = {"frequency_Hz": 50.03, "volt": float(noise), "phase_deg": 20.0}
    law = {"name": "mains-interference", "parameters": mains}
    harmed = replace(later, voltage=planted.plant(later, [law]))
    assert named(control, harmed) == [("mains-interference", (None, ()))]


def test_a_fault_from_the_middle_on_is_dated():
    control, later = session(1, count=40), session(2, count=40)
    voltage = later.voltage.copy()
    voltage[23:] = planted.plant(later, [FAULTS["drive"]])[23:]
    (found,) = difference(control, replace(later, voltage=voltage), NAMES).findings
    assert found.named and abs(found.onset_row - 23) <= 1


def test_a_factor_of_all_readings_is_no_fault():
    control, later = session(1), session(2)
    found = difference(control, replace(later, voltage=1.05 * later.voltage), NAMES)
    assert found.findings == [] and found.common_ratio == pytest.approx(0.05, abs=0.01)


def test_another_current_beside_an_offset_of_all_readings():
    """As of a real tank read with 60 and with 20 µA: readings fall to a third, and an offset that
    does not is named; it has no contact near by."""
    control, later = session(1), session(2)
    offset = -0.1 * float(np.median(np.abs(later.voltage)))
    found = difference(control, replace(later, voltage=later.voltage / 3.0 + offset), NAMES)
    assert [(one.name, one.named) for one in found.findings] == [("offset", True)]
    assert found.findings[0].change == pytest.approx(np.full(len(ADJACENT), offset), rel=0.02)
    assert found.common_ratio == pytest.approx(1.0 / 3.0 - 1.0, abs=2e-3)
    assert not any("contact" in sentence for sentence in sentences(found))


def test_a_passive_change_turns_nothing_round():
    """The odd half of reciprocity: none of a change of the network, half of one channel's."""
    control, later = session(1), session(2)
    change = channel_values(impedances(7), ADJACENT) * 0.01
    passive = difference(control, replace(later, voltage=later.voltage + change), NAMES)
    assert passive.odd_share(passive.wander.change) < 0.05
    voltage = later.voltage.copy()
    voltage[:, 40] *= 1.1
    own = difference(control, replace(later, voltage=voltage), NAMES)
    assert own.odd_share(own.wander.change) > 0.4


def test_a_change_of_the_whole_skin_is_no_fault_and_said():
    control, later = session(1), session(2)
    assert difference(control, later, NAMES).change_test[1] > 0.01
    change = channel_values(impedances(7), ADJACENT) * 0.01
    said = comparison(control, replace(later, voltage=later.voltage + change), NAMES)
    entry = said["difference"]
    assert not any(one["named"] for one in entry["found"])
    assert entry["moved"]["p_value"] < 1e-6 and entry["moved"]["times_scatter"] > 10.0
    if not entry["found"]:
        assert "times what they scatter" in said["sentences"][0]


def test_one_frame_each_tells_nothing_of_scatter():
    control, later = session(1, count=1), session(2, count=1)
    assert difference(control, later, NAMES).change_test[1] == 1.0


def test_one_frame_each_is_compared():
    control, later = session(1, count=1), session(2, count=1)
    assert difference(control, later, NAMES).findings == []
    assert difference(control, control, NAMES).findings == []
    voltage = planted.plant(later, [{**FAULTS["drive"], "parameters": {"gain": [1.1]}}])
    assert named(control, replace(later, voltage=voltage))[:1] == [("drive-gain", ("drives", (3,)))]


def test_readings_without_noise_are_compared():
    control, later = (session(1, count=20) for _ in range(2))
    plain = np.tile(control.voltage[:1], (20, 1))
    pair = [replace(each, voltage=plain) for each in (control, later)]
    assert difference(*pair, NAMES).findings == []
    harmed = replace(pair[1], voltage=planted.plant(pair[1], [FAULTS["pair"]]))
    assert named(pair[0], harmed) == [("measurement-gain", ("measures", (5,)))]


def test_other_channels_get_one_message():
    with pytest.raises(InputError, match=r"friday: key channels: found .* as in monday"):
        difference(session(1), session(2, PATTERNS["skip-2"]), NAMES)
    turned = session(2, ADJACENT[:, [0, 1, 3, 2]])
    with pytest.raises(InputError, match=r"found \[0, 1, 3, 2\] in row 0"):
        difference(session(1), turned, NAMES)
    with pytest.raises(InputError, match="key voltage: found magnitude"):
        difference(session(1), session(2, voltage="magnitude"), NAMES)


def test_the_command_writes_what_it_says(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    control, later = session(1), session(2)
    harmed = replace(later, voltage=planted.plant(later, [FAULTS["pair"]]))
    for name, each in zip(NAMES, (control, harmed), strict=True):
        recording.write(each, tmp_path / f"{name}.parquet")
    assert cli.main(["compare", "monday.parquet", "friday.parquet"]) == 0
    told = capsys.readouterr().out
    said = json.loads((tmp_path / "comparison-monday-vs-friday/comparison.json").read_text())
    assert said["parts"] == list(NAMES) and told.startswith(said["sentences"][0])
    (found,) = said["difference"]["found"]
    assert (found["name"], found["measures"], found["named"]) == ("measurement-gain", [5], True)
    assert found["ratio"] == pytest.approx(-0.003, rel=0.1)
    page = (tmp_path / "comparison-monday-vs-friday/comparison.html").read_text()
    assert "what is measured with its plus at electrode 5" in page
    assert cli.main(["compare", "monday.parquet", "nobody.parquet"]) == 1
    assert "nobody.parquet: file: found no such file" in capsys.readouterr().err
