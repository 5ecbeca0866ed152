"""The atlas: exact p-values under noise, and the planted fault where it was planted."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest, kstest

from eitskin.data.recording import Recording, presses
from eitskin.diagnose.noise.reciprocity import parity
from eitskin.diagnose.verdict.atlas import COLUMNS, atlas, repeat_p_value
from eitskin.diagnose.verdict.passing import without_passing
from eitskin.diagnose.verdict.remainder import remainder
from eitskin.effects.settings import settings, site_counts
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate

NOISE = 1e-3  # of the median |v|
DRAWS = 300


def frames_of(contacts):
    """Two untouched frames; per contact one more, four forces up and two down; two probes."""
    rng = np.random.default_rng(0)
    rows, time = [(0.0, False, 0.0, 0.0, 0.0, 0.0), (1.0, False, 0.0, 0.0, 0.0, 0.0)], 2.0
    for k in range(contacts):
        r, angle = 60.0 * np.sqrt(rng.uniform(0, 0.8)), rng.uniform(0, 2 * np.pi)
        rows.append((time, False, 0.0, 0.0, 0.0, 0.0))
        top = rng.uniform(4.0, 10.0)
        for step, share in enumerate((0.25, 0.5, 0.75, 1.0, 0.6, 0.3)):
            place = (r * np.cos(angle), r * np.sin(angle))
            rows.append((time + 3.0 + step, True, *place, share * top, 10.0 + 5.0 * (k % 2)))
        time += 12.0
    columns = ["time_s", "touch", "x_mm", "y_mm", "force_N", "probe_mm"]
    table = pd.DataFrame(rows, columns=columns)
    for key in ("x_mm", "y_mm", "probe_mm"):
        table.loc[~table["touch"], key] = np.nan
    return table.assign(frame=np.arange(len(table)), depth_mm=np.nan)


class Bench:
    """A skin of n electrodes, its frames, its noise-free readings with any effects."""

    def __init__(self, n=8, contacts=8, drive="adjacent", measure="adjacent"):
        self.channels = channel_table(n, drive, measure)
        self.skin = Skin(80.0, 3.0, 0.5, tuple(360.0 / n * np.arange(n)), 5.0, 2e-3, 1e-3, 0.9)
        self.frames = frames_of(contacts)
        self.press = presses(self.recording(None))
        self.clean = self.readings()
        self.sd = NOISE * np.median(np.abs(self.clean))

    def readings(self, *items):
        chosen = settings(list(items), site_counts(self.channels), (1, 0))
        skin, press = self.skin, self.press
        return simulate(self.frames, press, skin, self.channels, chosen, "train", frame_s=0.3)

    def recording(self, readings, frames=None, **metadata):
        skin = {
            "radius_mm": 80.0,
            "thickness_mm": 3.0,
            "conductivity_S_per_m": 0.5,
            "electrode_deg": list(self.skin.electrode_deg),
            "electrode_width_mm": 5.0,
            "contact_impedivity_ohm_m2": 2e-3,
            "current_A": 1e-3,
            "contrast_per_N": 0.9,
        }
        given = {
            "values": "absolute",
            "voltage": "signed",
            "clock": "measured",
            "position_frame": "skin",
            "channels": self.channels.tolist(),
            "skin": skin,
        }
        frames = self.frames if frames is None else frames
        return Recording(frames, readings, None, None, given | metadata)

    def gain(self):
        """The direction of a common gain, which every diagnosis fits."""
        return (self.clean / self.sd).reshape(-1, 1)

    def ask(self, voltage, seed=0, fitted=None, frames=None, **metadata):
        noise = np.random.default_rng(seed).standard_normal(self.clean.shape)
        fitted = self.gain() if fitted is None else fitted
        residual = (voltage - self.clean) / self.sd + noise
        asked = self.recording(voltage, frames, **metadata)
        return atlas(asked, residual, self.clean / self.sd, fitted)


@pytest.fixture(scope="module")
def small():
    return Bench()


@pytest.fixture(scope="module")
def ring():
    return Bench(16, 10)


def q_of(table, statistic, site=""):
    row = table[(table["statistic"] == statistic) & (table["site"] == site)]
    assert len(row) == 1
    return row["q"].iloc[0]


def top(table, statistic):
    return table[table["statistic"] == statistic].iloc[0]


def null_tables(bench):
    """Tables of pure noise, after a common gain, an electrode and 10 odd directions were fitted."""
    rng = np.random.default_rng(5)
    electrode = bench.readings(
        {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": 1.05}}
    )
    fitted = np.column_stack(
        [
            bench.gain(),
            (electrode - bench.clean).reshape(-1, 1) / bench.sd,
            rng.standard_normal((bench.clean.size, 10)),
            # One channel in every frame: rows of which it is a part lose a degree of freedom.
            np.tile(np.arange(len(bench.channels)) == 4, len(bench.clean)).astype(float),
        ]
    )
    basis = np.linalg.qr(fitted)[0]
    tables = []
    for seed in range(DRAWS):
        noise = np.random.default_rng(1000 + seed).standard_normal(bench.clean.size)
        residual = (noise - basis @ (basis.T @ noise)).reshape(bench.clean.shape)
        recording = bench.recording(bench.clean)
        tables.append(atlas(recording, residual, bench.clean / bench.sd, fitted))
    return tables


@pytest.fixture(scope="module")
def nulls(small):
    return null_tables(small)


def p_values(tables):
    frame = pd.concat(tables)
    return frame.groupby(["statistic", "site"])["p"].apply(np.array)


@pytest.mark.long
def test_every_row_s_p_is_uniform_under_noise(nulls):
    p = p_values(nulls)
    assert len(p) > 150 and all(len(values) == DRAWS for values in p)
    worst = min(kstest(values, "uniform").pvalue for values in p)
    assert worst > 0.01 / len(p)
    ks = np.array([kstest(values, "uniform").pvalue for values in p])
    assert 0.3 < np.median(ks) < 0.7


@pytest.mark.long
def test_false_discoveries_are_under_control(nulls):
    false = sum((table["q"] < 0.05).any() for table in nulls)
    assert binomtest(false, DRAWS, 0.05, alternative="greater").pvalue > 0.01


@pytest.mark.long
def test_p_is_uniform_with_readings_lost(small):
    rng = np.random.default_rng(2)
    lost = rng.random(small.clean.shape) < 0.05
    lost[:, 7] = True
    basis = np.linalg.qr(small.gain() * ~lost.reshape(-1, 1))[0]
    tables = []
    for seed in range(DRAWS // 2):
        noise = np.random.default_rng(seed).standard_normal(small.clean.shape) * ~lost
        residual = noise.ravel() - basis @ (basis.T @ noise.ravel())
        residual = np.where(lost, np.nan, residual.reshape(lost.shape))
        voltage = np.where(lost, np.nan, small.clean)
        sim = small.clean / small.sd
        tables.append(atlas(small.recording(voltage), residual, sim, small.gain()))
    p = p_values(tables)
    assert min(kstest(values, "uniform").pvalue for values in p) > 0.01 / len(p)
    assert top(tables[0], "constant: any channel")["dof"] == len(small.channels) - 1
    assert top(tables[0], "everything")["dof"] == (~lost).sum() - 1


@pytest.mark.long
def test_p_is_uniform_for_differences(small):
    def centred(residual):
        return residual - residual.mean(axis=0)

    # A free constant a channel is fitted together with the rest.
    columns = centred(small.gain().reshape(small.clean.shape)).reshape(-1, 1)
    tables = []
    for seed in range(DRAWS // 2):
        noise = centred(np.random.default_rng(seed).standard_normal(small.clean.shape)).ravel()
        unit = columns / np.linalg.norm(columns)
        residual = (noise - unit[:, 0] * (unit[:, 0] @ noise)).reshape(small.clean.shape)
        sim = (small.clean - small.clean[~small.frames["touch"]].mean(axis=0)) / small.sd
        recording = small.recording(small.clean, values="difference")
        tables.append(atlas(recording, residual, sim, small.gain()))
    p = p_values(tables)
    assert min(kstest(values, "uniform").pvalue for values in p) > 0.01 / len(p)
    assert not any(statistic.startswith("constant") for statistic, _ in p.index)
    rows = small.clean.size - len(small.channels) - 1
    assert top(tables[0], "everything")["dof"] == rows


def test_what_was_fitted_is_no_finding(small):
    gained = 1.05 * small.clean
    assert (small.ask(gained)["q"] > 0.05).all()
    assert (small.ask(gained, fitted=np.zeros((small.clean.size, 0)))["q"] < 0.05).any()


def test_a_statistic_that_was_fitted_whole_has_no_row(small):
    constants = np.zeros((*small.clean.shape, len(small.channels)))
    constants[:, np.arange(len(small.channels)), np.arange(len(small.channels))] = 1.0
    table = small.ask(small.clean, fitted=constants.reshape(small.clean.size, -1))
    assert not table["statistic"].str.startswith("constant").any()
    assert table["statistic"].str.startswith("force").any()


def test_a_planted_drive_gain(ring):
    table = ring.ask(
        ring.readings({"name": "drive-gain", "drives": [4], "parameters": {"gain": 1.02}})
    )
    assert table["statistic"].iloc[0] == "constant: drive"
    assert top(table, "constant: drive")["site"] == "4 → 5"
    assert set(table[table["statistic"] == "constant: electrode"]["site"][:3]) >= {"4", "5"}
    assert q_of(table, "untouched: reciprocity", "odd") < 1e-6
    expected = "Drive 4 → 5 differs from the simulation in every frame."
    assert top(table, "constant: drive")["sentence"] == expected


def test_a_moved_electrode_is_even_and_at_its_place(ring):
    moved = {"name": "electrode-position", "electrodes": [6], "parameters": {"shift_deg": 0.05}}
    table = ring.ask(ring.readings(moved))
    assert top(table, "constant: electrode")["site"] == "6"
    assert q_of(table, "untouched: reciprocity", "odd") > 0.05
    assert q_of(table, "untouched: reciprocity", "even") < 1e-6


def test_a_contact_is_even_and_within_one_electrode(ring):
    contact = {"name": "contact-impedance", "electrodes": [6], "parameters": {"ratio": 1.3}}
    table = ring.ask(ring.readings(contact))
    rows = table[table["statistic"] == "constant: electrode"]
    assert set(rows["site"][:3]) == {"5", "6", "7"}
    assert q_of(table, "untouched: reciprocity", "odd") > 0.05


def test_a_planted_memory_is_odd_and_of_the_scan(ring):
    memory = {"name": "multiplexer-memory", "parameters": {"mu": 0.002}}
    table = ring.ask(ring.readings(memory))
    assert table["statistic"].iloc[0] == "scan: channel before"
    assert q_of(table, "untouched: reciprocity", "odd") < 1e-6


def test_planted_shapes_are_their_harmonics(ring):
    for harmonic in (2, 3):
        shape = {"harmonic": harmonic, "amplitude": 0.002, "phase_deg": 20.0}
        table = ring.ask(ring.readings({"name": "domain-shape", "parameters": shape}))
        assert top(table, "untouched: harmonic")["site"] == str(harmonic)


@pytest.mark.parametrize(
    ("name", "parameters", "statistic"),
    [
        ("frame-skew", {"fraction": 0.3}, "scan: changing force"),
        ("conductivity-drift", {"per_minute": 0.01}, "time: every reading"),
        ("hysteresis", {"fraction": 0.05}, "load direction: touch signal"),
        ("relaxation", {"fraction": 0.05, "tau_s": 3.0}, "dwell: touch signal"),
        ("contact-law", {"exponent": 0.9}, "force: touch signal"),
        ("force-dependent-gain", {"per_N": 0.001}, "force: every reading"),
        ("adc-nonlinearity", {"cubic": 0.5}, "amplitude: cube"),
        ("registration", {"dx_mm": 0.5}, "position: electrode"),
    ],
)
def test_a_planted_law_is_found(ring, name, parameters, statistic):
    table = ring.ask(ring.readings({"name": name, "parameters": parameters}))
    assert top(table, statistic)["q"] < 1e-3
    if name in ("frame-skew", "force-dependent-gain", "conductivity-drift"):
        assert table["statistic"].iloc[0] == statistic


def test_shuffled_forces_take_the_evidence_away(small):
    """A misfit that goes with the force, and nothing else, asked of the right and wrong forces."""
    touch = small.frames["touch"].to_numpy()
    force = small.frames["force_N"].to_numpy()
    course = np.where(touch, force - force[touch].mean(), 0.0)
    profile = np.random.default_rng(0).standard_normal(len(small.channels))
    planted = small.clean + small.sd * 0.2 * np.outer(course, profile)
    assert q_of(small.ask(planted), "force: any channel") < 1e-6
    ratios = []
    for seed in range(20):
        shuffled = small.frames.copy()
        order = np.random.default_rng(seed).permutation(np.flatnonzero(touch))
        shuffled.loc[touch, "force_N"] = force[order]
        row = top(small.ask(planted, frames=shuffled), "force: any channel")
        ratios.append(row["value"] / row["dof"])
    told = top(small.ask(planted), "force: any channel")
    excess = np.mean(ratios) - 1.0
    # Of a fixed vector's energy a random direction among n has 1 / n.
    expected = (told["value"] / told["dof"] - 1.0) / (touch.sum() - 1)
    assert excess == pytest.approx(expected, abs=0.6)
    assert excess < 0.05 * (told["value"] / told["dof"])


def test_opposite_drive():
    bench = Bench(8, 4, "opposite", "opposite")
    gain = {"name": "channel-gain", "channels": [9], "parameters": {"gain": 1.05}}
    table = bench.ask(bench.readings(gain))
    source, sink = bench.channels[9, :2]
    assert top(table, "constant: drive")["site"] == f"{source} → {sink}"
    assert q_of(table, "untouched: reciprocity", "odd") < 1e-6
    assert (bench.ask(bench.clean)["q"] > 0.05).all()


def test_without_reciprocal_pairs_there_is_no_parity():
    bench = Bench(8, 4, "adjacent", "opposite")
    table = bench.ask(bench.clean)
    assert not table["statistic"].str.contains("reciprocity").any()


def test_magnitudes(ring):
    gain = {"name": "drive-gain", "drives": [4], "parameters": {"gain": 1.02}}
    size = np.abs(ring.clean)
    noise = np.random.default_rng(0).standard_normal(size.shape)
    residual = (np.abs(ring.readings(gain)) - size) / ring.sd + noise
    recording = ring.recording(size, voltage="magnitude")
    table = atlas(recording, residual, size / ring.sd, np.abs(ring.gain()))
    assert top(table, "constant: drive")["site"] == "4 → 5"
    assert q_of(table, "untouched: reciprocity", "odd") < 1e-6


def test_without_touches(small):
    still = ~small.frames["touch"].to_numpy()
    frames = small.frames[still].reset_index(drop=True)
    noise = np.random.default_rng(0).standard_normal((still.sum(), len(small.channels)))
    recording = small.recording(small.clean[still], frames)
    table = atlas(recording, noise, small.clean[still] / small.sd, np.zeros((noise.size, 0)))
    law = table["statistic"].str.split(":").str[0]
    assert set(law) == {"everything", "constant", "untouched", "time", "scan", "amplitude"}
    assert (table["q"] > 0.05).all()


def test_what_is_unknown_has_no_rows(small):
    frames = small.frames.assign(force_N=np.where(small.frames["touch"], np.nan, 0.0))
    frames["probe_mm"] = np.nan
    table = small.ask(small.clean, frames=frames, clock="index", position_frame="robot")
    law = set(table["statistic"].str.split(":").str[0])
    assert not law & {"force", "load direction", "dwell", "probe", "time"}
    assert "order" in law
    assert "position: electrode" not in set(table["statistic"])


def test_one_frame(small):
    frames = small.frames.iloc[:1]
    noise = np.random.default_rng(0).standard_normal((1, len(small.channels)))
    simulated = small.clean[:1] / small.sd
    recording = small.recording(small.clean[:1], frames)
    table = atlas(recording, noise, simulated, simulated.reshape(-1, 1))
    assert list(table.columns) == COLUMNS
    assert top(table, "everything")["dof"] == len(small.channels) - 1
    assert np.isfinite(table["p"]).all()


def test_two_sessions(small):
    session = np.where(np.arange(len(small.frames)) < 30, "monday", "tuesday")
    frames = small.frames.assign(session=session)
    planted = small.clean.copy()
    planted[30:, 3] += 5.0 * small.sd
    table = small.ask(planted, frames=frames)
    assert q_of(table, "session: any channel", "tuesday") < 1e-6


def lasting(shape, correlation, seed):
    """(N, M) first-order noise of unit variance."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    for row in range(1, len(noise)):
        noise[row] = correlation * noise[row - 1] + np.sqrt(1.0 - correlation**2) * noise[row]
    return noise


def remainder_of(bench, residual):
    recording = bench.recording(bench.clean)
    return remainder(atlas(recording, residual, bench.clean / bench.sd, bench.gain()))


@pytest.mark.parametrize("correlation", [0.8, 0.97])
def test_noise_that_the_covariance_does_not_know_is_nothing_without_a_name(ring, correlation):
    """White to the covariance, it lasts: rows by the covariance alone would be alarms."""
    shape, alarms = ring.clean.shape, 0
    for seed in range(12):
        residual = lasting(shape, correlation, seed)
        table = atlas(ring.recording(ring.clean), residual, ring.clean / ring.sd, ring.gain())
        lasting_rows = ~table["statistic"].str.startswith(("time", "press", "everything"))
        alarms += table[lasting_rows]["p"].min() < 1e-6
        assert remainder(table).probability < 0.5
    assert alarms == 12


def test_what_a_skin_does_stands_out_of_noise_that_lasts(ring):
    even = parity(ring.channels)[1][:, 20]
    residual = lasting(ring.clean.shape, 0.9, 1)
    assert remainder_of(ring, residual + 3.0 * ring.frames["touch"].to_numpy()[:, None] * even)
    touched = ring.frames["touch"].to_numpy(float)[:, None]
    left = remainder_of(ring, residual + 8.0 * touched * even)
    assert left.probability > 0.5 and left.sentence is not None


@pytest.mark.parametrize("course", ["time", "press"])
def test_change_with_time_alone_or_in_one_press_is_the_rig_s(ring, course):
    noise = np.random.default_rng(3).standard_normal(ring.clean.shape)
    even = parity(ring.channels)[1]
    profile = even @ np.random.default_rng(4).standard_normal(even.shape[1])
    time = ring.frames["time_s"].to_numpy()
    along = time / time[-1] - 0.5 if course == "time" else (ring.press == 3).astype(float)
    assert remainder_of(ring, noise + along[:, None] * profile).probability < 0.5


@pytest.mark.parametrize("course", ["time", "press"])
def test_a_large_change_that_passes_leaves_nothing_behind_where_it_is_taken_out(ring, course):
    """Of a misfit that follows the force in all presses, enough stays."""
    even = parity(ring.channels)[1]
    draw = np.random.default_rng(4)
    profile = even @ draw.standard_normal((even.shape[1], 2))
    noise = draw.standard_normal(ring.clean.shape)
    time = ring.frames["time_s"].to_numpy()
    along = time / time[-1] - 0.5 if course == "time" else (ring.press == 3).astype(float)
    force = ring.frames["force_N"].to_numpy() / 10.0
    for size, alarm in ((0.0, False), (2.0, True)):
        residual = noise + 4.0 * along[:, None] * profile[:, 0]
        residual += size * force[:, None] * profile[:, 1]
        recording = ring.recording(ring.clean)
        table = atlas(recording, residual, ring.clean / ring.sd, ring.gain())
        assert remainder(table).probability > 0.5
        left = without_passing(recording, residual, table)
        table = atlas(recording, left, ring.clean / ring.sd, ring.gain())
        assert (remainder(table).probability > 0.5) == alarm


@pytest.mark.parametrize(("units", "size"), [(5, 1), (12, 1), (12, 20)])
def test_p_values_of_what_repeats_have_no_need_of_a_covariance(units, size):
    rng = np.random.default_rng(6)
    root = rng.standard_normal((size, size)) * np.geomspace(1.0, 30.0, size)
    p = [repeat_p_value(rng.standard_normal((units, size)) @ root) for _ in range(400)]
    assert np.mean(np.array(p) < 0.05) < 0.08 and np.mean(np.array(p) < 0.5) > 0.35
    constant = 3.0 * np.abs(root).sum(axis=0)
    assert repeat_p_value(rng.standard_normal((units, size)) @ root + constant) < 0.02
