"""Objects between two recordings: found, with their sign and place, from readings of a solver that
shares nothing with the project's, and from real tanks."""

import json
from dataclasses import replace

import numpy as np
import pytest

from eitskin import cli
from eitskin.data import recording
from eitskin.data.importers.description import describe
from eitskin.data.recording import Recording, frames_table
from eitskin.diagnose.compare.difference import difference
from eitskin.diagnose.compare.discs import Disc, coordinates_of, derivatives_at, discs_at
from eitskin.diagnose.compare.objects import NAME
from eitskin.diagnose.compare.result import comparison
from eitskin.diagnose.compare.sheet import Sheet
from eitskin.physics.forward import channel_values
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table
from proof import planted
from shared_data import shared_data
from witness import boundary
from witness.curves import Shape

N, R_MM = 16, 100.0
NAMES = ("empty", "later")
ADJACENT = channel_table(N)
BODY = boundary.Body(Shape(R_MM), even_angles(N), np.full(N, 10.0), 5.0)

# x, y, radius in mm, conductivity inside over outside
METAL, AIR = (50.0, 20.0, 15.0, 200.0), (-10.0, -45.0, 12.0, 0.005)
WET, DRY = (-60.0, 30.0, 14.0, 2.0), (5.0, 10.0, 20.0, 0.5)


def session(
    seed: int, inside=(), count: int = 10, voltage: str = "signed", body=BODY, **more
) -> Recording:
    """Frames of a tank with objects inside, by electrodes of a width of their own and a board whose
    channels have gains: 2 % (sd), the same in every session."""
    discs = [boundary.Disc(x, y, radius) for x, y, radius, _ in inside]
    contact = body.contact(np.full(N, 0.02))
    admittance = body.place(discs).admittance(contact, [ratio - 1.0 for *_, ratio in inside])
    plain = channel_values(np.linalg.pinv(admittance), ADJACENT)
    plain *= np.exp(np.random.default_rng(0).normal(0.0, 0.02, len(ADJACENT)))
    draw = np.random.default_rng(seed)
    noise = 1e-3 * np.median(np.abs(plain))
    readings = plain + noise * draw.normal(size=(count, len(plain)))
    readings = np.abs(readings) if voltage == "magnitude" else readings
    skin = {"radius_mm": R_MM} | more
    metadata = describe(ADJACENT, even_angles(N), "witness", voltage, skin=skin)
    still = frames_table(np.arange(count, dtype=float), np.zeros(count, bool))
    return Recording(still, readings, None, None, metadata)


def named(control: Recording, later: Recording) -> list:
    """What is given."""
    return [one for one in difference(control, later, NAMES).findings if one.named]


@pytest.mark.parametrize("voltage", ["signed", "magnitude"])
@pytest.mark.parametrize("inside", [(METAL,), (AIR,), (WET,), (DRY,), (METAL, AIR), (WET, DRY)])
def test_objects_are_found_with_their_sign_and_place(inside, voltage):
    one, *more = named(session(1, voltage=voltage), session(2, inside, voltage=voltage))
    assert one.name == NAME and not more
    discs = one.explanation.signatures[0].discs
    assert len(discs) == len(inside)
    for x, y, _, ratio in inside:
        nearest = min(discs, key=lambda d: np.hypot(R_MM * d.x - x, R_MM * d.y - y))
        assert np.hypot(R_MM * nearest.x - x, R_MM * nearest.y - y) < 0.04 * R_MM
        assert nearest.conducting is (ratio > 1.0)
    held = one.object_fit.held_out
    assert held["rms_after"] < 0.3 * held["rms_before"]


def test_a_single_frame_each_shows_an_object():
    (one,) = named(session(1, count=1), session(2, (AIR,), count=1))
    assert one.name == NAME and not one.explanation.signatures[0].discs[0].conducting


def test_an_empty_tank_shows_nothing():
    assert difference(session(1), session(2), NAMES).findings == []


FAULTS = {
    "drive": {"name": "drive-gain", "drives": [3], "parameters": {"gain": [1.05]}},
    "pair": {"name": "measurement-gain", "measures": [5], "parameters": {"gain": [0.95]}},
    "crosstalk": {"name": "crosstalk", "parameters": {"epsilon": 0.005}},
    "memory": {"name": "multiplexer-memory", "parameters": {"mu": 0.005}},
    "offset": {"name": "offset", "parameters": {"volt": 0.002}},
}


@pytest.mark.parametrize("which", FAULTS)
def test_a_fault_is_no_object(which):
    control, later = session(1), session(2)
    voltage = planted.plant(later, [FAULTS[which]])
    found = named(control, replace(later, voltage=voltage))
    assert [one.name for one in found] == [FAULTS[which]["name"]]


def test_exchanged_wires_are_no_object():
    control, later = session(1), session(2)
    wires = np.arange(N)
    wires[[4, 9]] = 9, 4
    admittance = BODY.place([]).admittance(BODY.contact(np.full(N, 0.02)), [])
    there, crossed = (
        channel_values(np.linalg.pinv(admittance), table) for table in (ADJACENT, wires[ADJACENT])
    )
    found = named(control, replace(later, voltage=later.voltage + crossed - there))
    assert found[0].explanation.place == ("electrodes", (4, 9))


SKINS = {
    "electrodes moved": (Shape(R_MM), even_angles(N) + np.random.default_rng(3).normal(0, 0.3, N)),
    "rising conductivity": (Shape(R_MM, tilt=0.1), even_angles(N)),
    "out of round": (Shape(R_MM, {2: 0.01}), even_angles(N)),
}


@pytest.mark.parametrize(
    "which",
    [
        "electrodes moved",
        "out of round",
        pytest.param("rising conductivity", marks=pytest.mark.long),
    ],
)
def test_another_change_of_the_skin_is_no_object(which):
    shape, angle = SKINS[which]
    body = boundary.Body(shape, angle, np.full(N, 10.0), 5.0)
    assert all(one.name != NAME for one in named(session(1), session(2, body=body)))


def test_what_reads_as_no_sheet_is_not_simulated():
    control, later = session(1), session(2, (METAL,))
    shuffled = np.random.default_rng(1).permutation(len(ADJACENT))
    pair = [replace(each, voltage=each.voltage[:, shuffled]) for each in (control, later)]
    unknown = [
        replace(each, metadata={**each.metadata, "skin": {"electrode_deg": None}})
        for each in (control, later)
    ]
    for each in (pair, unknown):
        assert all(one.name != NAME for one in difference(*each, NAMES).findings)


def test_slopes_are_derivatives():
    sheet = Sheet(ADJACENT, even_angles(N), False)
    at = np.concatenate([coordinates_of(Disc(0.5, 0.2, 0.15, 5.0)), [-0.4, 0.3, -2.0, -1.0]])
    slope = sheet.derivatives(discs_at(at)) @ derivatives_at(at)
    for k in range(len(at)):
        step = np.zeros(len(at))
        step[k] = 1e-4
        two = [sheet.change(discs_at(at + sign * step)) for sign in (1.0, -1.0)]
        numeric = (two[0] - two[1]) / 2e-4
        assert np.linalg.norm(slope[:, k] - numeric) < 0.02 * np.linalg.norm(numeric)


def test_coordinates_are_those_of_the_disc():
    disc = Disc(0.5, -0.3, 0.2, 0.1)
    (back,) = discs_at(coordinates_of(disc))
    for key in ("x", "y", "radius", "ratio"):
        assert getattr(back, key) == pytest.approx(getattr(disc, key))


def test_the_entry_says_where_and_how_sure(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, each in zip(NAMES, (session(1), session(2, (DRY,))), strict=True):
        recording.write(each, tmp_path / f"{name}.parquet")
    assert cli.main(["compare", "empty.parquet", "later.parquet"]) == 0
    said = json.loads((tmp_path / "comparison-empty-vs-later/comparison.json").read_text())
    (one,) = said["difference"]["found"]
    (thing,) = one["objects"]
    assert (one["name"], one["named"], thing["conducting"]) == (NAME, True, False)
    for key, true in (("x_mm", DRY[0]), ("y_mm", DRY[1])):
        assert thing[key]["low"] < thing[key]["value"] < thing[key]["high"]
        assert thing[key]["value"] == pytest.approx(true, abs=4.0)
    assert thing["contrast"]["value"] < 1.0
    assert "an insulating one at" in capsys.readouterr().out
    nowhere = [session(s, i, radius_mm=None) for s, i in ((1, ()), (2, (DRY,)))]
    said = comparison(*nowhere, NAMES)
    assert said["difference"]["found"][0]["objects"][0]["x_mm"] is None
    assert "of the radius from the centre" in said["sentences"][0]


def test_a_part_of_a_file_is_compared(tmp_path, capsys):
    """pyeidors-tank keeps reference and target in one file."""
    columns = []
    for inside in ((), (METAL,)):
        reading = session(1, inside, 1).voltage[0] * np.exp(0.1j)
        columns += [-reading.real, -reading.imag]
    order = np.lexsort(((ADJACENT[:, 2] - ADJACENT[:, 0]) % N, ADJACENT[:, 0]))
    file = tmp_path / "tank.csv"
    np.savetxt(file, np.column_stack(columns)[order], delimiter=",")
    out = ["--out", str(tmp_path / "out")]
    assert cli.main(["compare", str(file), str(file), "--part", "target", *out]) == 0
    assert "something lies in the skin: a conducting one at 22°" in capsys.readouterr().out
    assert cli.main(["compare", str(file), str(file), "--part", "rod", *out]) == 1
    assert "part: found 'rod', expected one of target" in capsys.readouterr().err


def test_the_real_rod_is_an_insulator(tmp_path, capsys):
    file = str(shared_data("iirc-tank/iirc_data_2006.mat"))
    out = ["--out", str(tmp_path / "out")]
    assert cli.main(["compare", file, file, "--part", "v_rotate:60", *out]) == 0
    assert "an insulating one" in capsys.readouterr().out
    assert cli.main(["compare", file, file, "--part", "v_rotate:100", *out]) == 1
    assert "v_rotate:0 to v_rotate:99" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("file", "said"),
    [("metal_1", "a conducting one at 357°"), ("plastic_1", "an insulating one at 356°")],
)
def test_real_objects_of_the_lct(file, said, tmp_path, capsys):
    folder = shared_data("lct-tank")
    empty, later = folder / "homogeneous", folder / "objects" / f"{file}.txt"
    assert cli.main(["compare", str(empty), str(later), "--out", str(tmp_path / "out")]) == 0
    assert said in capsys.readouterr().out
