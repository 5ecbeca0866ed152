import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import eitskin
from benchmark import images
from eitskin import peers
from eitskin.diagnose.verdict.words import all_sentences
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.scripting import Report
from eitskin.simulators import Simulator

ROOT = Path(__file__).parents[3]
SAMPLE = ROOT / "docs" / "sample"
SHIFTED = {"name": "electrode-position", "electrodes": [6], "parameters": {"shift_deg": [2.0]}}
MAX_IMPORT_S = 0.3
FEW = 6  # frames


@pytest.fixture(scope="module")
def sample():
    return eitskin.read(SAMPLE / "recording.parquet")


@pytest.fixture(scope="module")
def few(sample):
    return eitskin.read(SAMPLE / "recording.parquet", frames=(0, FEW - 1))


@pytest.fixture(scope="module")
def shifted(sample):
    return Simulator(sample.skin, [SHIFTED])


def test_the_import_is_quick_and_takes_no_library_of_science():
    code = (
        "import sys, time; start = time.perf_counter(); import eitskin; "
        "print(time.perf_counter() - start, *sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    seconds, *modules = ran.stdout.split()
    assert float(seconds) < MAX_IMPORT_S
    assert not {"torch", "scipy", "numpy", "pandas"} & {*modules}


def test_all_that_is_offered_is_there_and_a_package_is_its_function(few):
    for name in eitskin.__all__:
        assert callable(getattr(eitskin, name)) and name in dir(eitskin)
    with pytest.raises(AttributeError, match="nothing"):
        eitskin.nothing  # noqa: B018
    from eitskin.simulate import readings

    assert eitskin.simulate.readings is readings
    assert eitskin.simulate(few).shape == few.voltage.shape


def test_what_a_user_gets_wrong_is_said_in_one_line(few, tmp_path):
    assert not {"import_module", "MODULES", "Any"} & {*dir(eitskin)}
    assert repr(few).startswith(f"<recording of {FEW} frames of 208 channels: ")
    for function in (eitskin.simulate, eitskin.jacobian, eitskin.diagnose):
        with pytest.raises(eitskin.InputError, match="found a str, expected what eitskin"):
            function("skin.csv")
    with pytest.raises(InputError, match=r"No such file .*, expected the folder"):
        Report.read(tmp_path)
    with pytest.raises(InputError, match=r"shape \(6, 2\), expected \(2,\), one frame's change"):
        eitskin.scripting.Jacobian(np.ones((2, 3)), np.ones((3, 3))).image(np.ones((6, 2)))


def test_what_is_stated_may_be_a_mapping_and_is_refused_as_a_file_is(sample):
    stated = eitskin.read(SAMPLE / "recording.parquet", {"radius_mm": 70.0}, (0, 9))
    assert stated.skin.radius_mm == 70.0 and len(stated.frames) == 10
    with pytest.raises(InputError, match="radius_cm"):
        eitskin.read(SAMPLE / "recording.parquet", {"radius_cm": 7.0})


def test_the_true_effect_leaves_less_than_the_belief(sample, shifted):
    corrected = np.std(sample.voltage - eitskin.simulate(sample, shifted))
    believed = np.std(sample.voltage - eitskin.simulate(sample))
    assert corrected < believed


def test_the_jacobian_by_discs_is_the_central_difference_of_a_patch_of_the_skin(few, shifted):
    discs = np.array([[0.0, 0.0, 8.0], [30.0, -20.0, 5.0]])
    jacobian = eitskin.jacobian(few, shifted, discs)
    for (x_mm, y_mm, radius_mm), column in zip(discs, jacobian.matrix.T, strict=True):
        ends = []
        for contrast in (0.99, 1.01):
            values = {"x_mm": x_mm, "y_mm": y_mm, "radius_mm": radius_mm, "contrast": contrast}
            patch = {"name": "conductivity-patch", "parameters": values}
            ends.append(eitskin.simulate(few, replace(shifted, effects=[SHIFTED, patch]))[0])
        expected = (ends[1] - ends[0]) / 0.02
        assert np.linalg.norm(column - expected) < 1e-3 * np.linalg.norm(expected)


@pytest.mark.parametrize("way", ["arbitrary", "unknown current", "robot"])
def test_a_jacobian_of_an_ordinary_recording_is_that_of_its_stated_twin(sample, way):
    discs = np.array([[10.0, 0.0, 5.0]])
    expected = eitskin.jacobian(sample, None, discs).matrix
    stated = {
        "arbitrary": {"unit": "arbitrary"},
        "unknown current": {"skin": sample.metadata["skin"] | {"current_A": None}},
        "robot": {"position_frame": "robot"},
    }[way]
    recorded = replace(sample, metadata=sample.metadata | stated)
    believed = Simulator.believed(recorded)
    matrix = eitskin.jacobian(recorded, believed, discs).matrix
    scale = np.median(np.abs(sample.voltage)) / np.median(np.abs(eitskin.simulate(sample)))
    assert matrix == pytest.approx(expected * (1.0 if way == "robot" else scale), rel=1e-6)
    query = replace(recorded, voltage=None)
    assert np.isfinite(eitskin.simulate(query, believed)).all()
    with pytest.raises(InputError, match="this is a query"):
        eitskin.simulate(query)


def test_the_robot_s_places_are_aligned_or_refused(sample, shifted):
    first = int(np.flatnonzero(sample.frames["touch"])[0])
    few = eitskin.read(SAMPLE / "recording.parquet", frames=(first - 1, first + FEW))
    turned = 1j * (few.frames["x_mm"] + 1j * few.frames["y_mm"])
    frames = few.frames.assign(x_mm=turned.to_numpy().real, y_mm=turned.to_numpy().imag)
    robot = replace(few, frames=frames, metadata=few.metadata | {"position_frame": "robot"})
    back = {"robot_scale": 1.0, "robot_rotation_deg": -90.0, "robot_x_mm": 0.0, "robot_y_mm": 0.0}
    aligned = replace(shifted, alignment=back)
    assert eitskin.simulate(robot, aligned) == pytest.approx(eitskin.simulate(few, shifted))
    for simulated in (eitskin.simulate, eitskin.effect_jacobian):
        with pytest.raises(InputError, match="position_frame"):
            simulated(robot, shifted)


def test_the_jacobian_of_all_pixels_is_that_of_a_conductivity(few, shifted):
    jacobian = eitskin.jacobian(few, shifted)
    ends = [
        eitskin.simulate(
            few,
            replace(shifted, skin=replace(few.skin, conductivity_S_per_m=conductivity)),
        )[0]
        for conductivity in np.array([0.999, 1.001]) * few.skin.conductivity_S_per_m
    ]
    expected = (ends[1] - ends[0]) / 0.002
    total = jacobian.matrix.sum(axis=1)
    assert np.corrcoef(total, expected)[0, 1] > 0.99


def test_the_jacobian_by_effect_is_the_central_difference_of_wider_steps(few):
    gain = {"name": "channel-gain", "channels": [3, 9], "parameters": {"gain": [1.02, 0.97]}}
    simulator = Simulator(few.skin, [SHIFTED, gain])
    derivatives = eitskin.effect_jacobian(few, simulator)
    assert [*derivatives] == [
        "electrode-position.shift_deg[6]",
        "channel-gain.gain[3]",
        "channel-gain.gain[9]",
    ]
    ends = []
    for shift in (1.98, 2.02):
        moved = SHIFTED | {"parameters": {"shift_deg": [shift]}}
        ends.append(eitskin.simulate(few, replace(simulator, effects=[moved, gain])))
    expected = (ends[1] - ends[0]) / 0.04
    derivative = derivatives["electrode-position.shift_deg[6]"]
    assert np.linalg.norm(derivative - expected) < 1e-3 * np.linalg.norm(expected)
    assert not derivatives["channel-gain.gain[9]"][:, :9].any()


def test_an_image_of_a_simulated_rise_is_where_it_was(few):
    believed = Simulator.believed(few)
    jacobian = eitskin.jacobian(few, believed)
    truth = int(np.argmin(np.hypot(*(jacobian.discs[:, :2] - [25.0, 10.0]).T)))
    change = 0.5 * jacobian.matrix[:, truth]
    change[4] = np.nan
    image = jacobian.image(change, strength=1e-3)
    found = jacobian.discs[np.argmax(image), :2]
    assert np.hypot(*(found - jacobian.discs[truth, :2])) < 0.1 * few.skin.radius_mm


def test_the_jacobian_of_magnitudes_is_the_central_difference_of_magnitudes(few, shifted):
    x_mm, y_mm, radius_mm = disc = [10.0, 0.0, 5.0]
    magnitude = replace(few, metadata=few.metadata | {"voltage": "magnitude"})
    matrix = eitskin.jacobian(magnitude, shifted, np.array([disc])).matrix
    ends = []
    for contrast in (0.99, 1.01):
        values = {"x_mm": x_mm, "y_mm": y_mm, "radius_mm": radius_mm, "contrast": contrast}
        patch = {"name": "conductivity-patch", "parameters": values}
        ends.append(np.abs(eitskin.simulate(few, replace(shifted, effects=[SHIFTED, patch]))[0]))
    expected = (ends[1] - ends[0]) / 0.02
    assert np.linalg.norm(matrix[:, 0] - expected) < 1e-3 * np.linalg.norm(expected)


def test_a_recording_that_is_not_usable_is_refused_with_its_reason(sample):
    broken = replace(sample, voltage=-sample.voltage)
    with pytest.raises(InputError, match="check, polarity"):
        eitskin.diagnose(broken)


def test_a_comparison_is_a_report_that_a_notebook_shows(sample):
    later = replace(sample, voltage=sample.voltage * np.where(np.arange(208) == 7, 1.05, 1.0))
    report = eitskin.compare(sample, later, ("a", "b <script>"))
    shown = report._repr_html_()
    assert "<strong>" in shown and "<script>" not in shown
    assert report.document["sentences"] == report.sentences
    with pytest.raises(InputError, match=r"eitskin\.diagnose"):
        report.write("captures/nowhere")


@pytest.mark.long
def test_a_report_is_written_and_read_again(sample, tmp_path):
    query = eitskin.read(SAMPLE / "recording.parquet", frames=(0, FEW - 1))
    report = eitskin.diagnose(sample, query=query)
    assert "Electrode 6" in report._repr_html_()
    assert report.write(tmp_path).is_file()
    predicted = pd.read_parquet(tmp_path / "predicted.parquet")
    assert np.stack(predicted["voltage_V"]) == pytest.approx(report.record.prediction[0])
    again = Report.read(tmp_path)
    assert again.sentences == report.sentences == all_sentences(report.document)
    ours, theirs = (eitskin.simulate(sample, item.simulator) for item in (report, again))
    assert np.linalg.norm(ours - theirs) < 1e-6 * np.linalg.norm(ours)


def test_a_simulator_is_read_with_its_factor_and_the_robot_s_frame_of_a_diagnosis(few, tmp_path):
    (tmp_path / "effects.yaml").write_text(
        json.dumps({"twin": {"skin": few.skin.metadata(), "effects": []}})
    )
    values = {"factor": 3.0, "robot_scale": -1.1, "thickness_mm": 2.0}
    calibration = {key: {"value": value} for key, value in values.items()}
    (tmp_path / "diagnosis.json").write_text(json.dumps({"calibration": calibration}))
    simulator = Simulator.read(tmp_path)
    assert simulator.factor == 3.0 and simulator.alignment == {"robot_scale": -1.1}


def test_the_simulator_of_ohms_has_one_ampere(few):
    ohms = replace(few, metadata=few.metadata | {"unit": "ohm"})
    assert Simulator.believed(ohms).skin.current_A == 1.0


def test_a_folder_without_a_diagnosis_is_refused(tmp_path):
    with pytest.raises(InputError, match="the folder that eitskin diagnose wrote"):
        Report.read(tmp_path)
    (tmp_path / "other.yaml").write_text("twin: 3")
    with pytest.raises(InputError, match="key twin"):
        Simulator.read(tmp_path / "other.yaml")


def test_pyeit_reads_our_skin_by_our_channels_in_our_order_and_sign(few):
    fem = pytest.importorskip("pyeit.eit.fem")
    mesh = peers.pyeit_mesh(Geometry.from_skin(few.skin))
    protocol = peers.pyeit_protocol(few.channels)
    assert (peers.channels(protocol) == few.channels).all()
    theirs = fem.EITForward(mesh, protocol).solve_eit(1.0)
    assert np.corrcoef(theirs, eitskin.simulate(few)[0])[0, 1] > 0.999
    area = np.pi * (peers.discs(mesh.node, mesh.element)[:, 2] ** 2).sum()
    assert area == pytest.approx(np.pi * few.skin.radius_mm**2, rel=0.02)
    with pytest.raises(InputError, match="drive by drive"):
        peers.pyeit_protocol(few.channels[np.argsort(few.channels[:, 2], kind="stable")])


def test_a_model_for_eidors_is_read_again(tmp_path):
    node = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    element = np.array([[0, 1, 2], [0, 2, 3]])
    channels = np.array([[0, 1, 2, 1], [0, 1, 1, 2], [1, 2, 0, 2]])
    matrix = np.arange(6.0).reshape(3, 2)
    peers.write_eidors(tmp_path / "m.mat", node, element, [1, 2, 3], channels, matrix)
    nodes, elements = peers.read_eidors(tmp_path / "m.mat")
    assert (nodes == node).all() and (elements == element).all()
    space = np.array([[0, 1, 2, 3]])
    peers.write_eidors(tmp_path / "space.mat", node, space, [1, 2, 3], channels)
    with pytest.raises(InputError, match=r"elems: found shape \(1, 4\)"):
        peers.read_eidors(tmp_path / "space.mat")
    (tmp_path / "other.mat").write_bytes(b"MATLAB")
    with pytest.raises(InputError, match="damaged or cut"):
        peers.read_eidors(tmp_path / "other.mat")


@pytest.mark.long
def test_with_our_matrix_pyeit_has_the_sample_s_presses_nearer(sample, shifted):
    pytest.importorskip("pyeit.eit.jac")
    rows = images.table(sample, shifted)
    assert len(rows) == len(pd.read_csv(SAMPLE / "images.csv"))
    assert rows["ours_mm"].mean() < rows["own_mm"].mean()


def test_the_notebook_has_the_lines_of_the_page():
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    lines = page.partition("# captures/image.py\n")[2].partition("```")[0].strip().split("\n")
    notebook = json.loads((ROOT / "docs" / "tutorials" / "from_python.ipynb").read_text("utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    code = "\n\n".join("".join(cell["source"]) for cell in cells)
    assert code.split("\n") == lines
    assert len([line for line in lines if line]) <= 24
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells)
