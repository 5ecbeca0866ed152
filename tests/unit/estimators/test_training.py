import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from eitskin import cli
from eitskin.data import recording
from eitskin.diagnose.report import answer
from eitskin.errors import InputError
from eitskin.estimators import training
from eitskin.estimators.sets import source_set
from eitskin.exported import predictor
from eitskin.simulate.imitation import PressPrior
from eitskin.simulators import Simulator
from loop_skin import FORCES, JITTER, LAW
from small_skin import SKIN, small_recording

SMALL = {"samples": 500, "epochs": 2, "seeds": 2, "spare_epochs": 1}
PLACES = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What a diagnosis that put the last two presses aside leaves."""
    folder = tmp_path_factory.mktemp("diagnosis")
    recorded = small_recording(LAW, places=PLACES)
    frames = recorded.frames
    contact = np.repeat(np.arange(-1, PLACES), [4, *[5] * PLACES])
    recorded.frames["contact"] = contact
    recorded.frames["contact"] = frames["contact"].astype("Int64").where(frames["touch"])
    recording.write(recorded, folder / "recording.parquet")
    (folder / "effects.yaml").write_text(
        json.dumps({"twin": {"skin": SKIN.metadata(), "effects": [LAW]}})
    )
    (folder / "diagnosis.json").write_text(json.dumps({"calibration": {}}))
    (folder / "evidence").mkdir()
    aside = (contact >= PLACES - 2).astype(int)
    np.savez(folder / "evidence" / "residuals.npz", last=aside, time_s=frames["time_s"])
    return folder


@pytest.fixture(scope="module")
def estimator(folder):
    return training.trained(folder, perturbations=[JITTER], plan=training.Plan(**SMALL))


def test_the_card_has_every_model_on_labels_put_aside_and_on_fresh_touches(estimator):
    card = estimator.card.set_index(["tested on", "trained on", "labels"]).sort_index()
    for name in (training.CORRECTED, training.BELIEF, training.PERTURBED):
        for tested in (training.ASIDE, training.FRESH):
            rows = card.loc[tested, name, 0]
            assert [*rows["target"]] == ["x", "y", "F"] and (rows["runs"] == 2).all()
            assert (rows["low"] <= rows["mae"]).all() and (rows["mae"] <= rows["high"]).all()
    aside = card.loc[training.ASIDE]
    assert (aside["frames"] == 8).all()
    assert {*aside.loc["fine-tuned"].index} == {5, 20} == {*aside.loc["affine"].index}


def test_the_estimator_is_what_the_stream_reads_and_carries_the_skin(estimator, tmp_path):
    path, card = estimator.write(tmp_path)
    read = predictor.read(path)
    assert read.header["dataset"]["channels"] == small_recording().channels.tolist()
    assert read.header["skin"]["radius_mm"] == SKIN.radius_mm and card.is_file()
    assert read.header["seeds"] == [1, 2]


def test_one_seed_has_no_interval_and_the_words_say_so(estimator):
    lines = training.sentences(estimator.card)
    assert any("2 seeds" in line and " to " in line for line in lines)
    single = estimator.card.assign(runs=1)
    assert all(line.endswith("one seed: no interval") for line in training.sentences(single))


def test_another_recording_tests_half_its_places(folder):
    target = small_recording(LAW, places=8, seed=5)
    tested = training._tests(
        recording.read(folder / "recording.parquet"),
        folder,
        target,
        source_set(
            Simulator.read(folder),
            recording.read(folder / "recording.parquet"),
            100,
            1,
            PressPrior(FORCES, 8.0),
            "set",
        ).dataset,
    )
    (test,), labelled = tested
    assert test.name == training.OTHER and len(test.states) == len(labelled.states) == 16
    places = {tuple(row) for row in test.states[:, :2]}
    assert not places & {tuple(row) for row in labelled.states[:, :2]}


def test_a_set_as_recorded_has_its_kind_of_voltage_and_lacks_what_it_lost(folder):
    recorded = recording.read(folder / "recording.parquet")
    voltage = np.abs(recorded.voltage)
    voltage[:, 3] = np.nan
    metadata = recorded.metadata | {"voltage": "magnitude"}
    lossy = replace(recorded, voltage=voltage, metadata=metadata)
    job = (Simulator.read(folder), lossy, 100, 1, PressPrior(FORCES, 8.0), "set")
    dataset = source_set(*job, True).dataset
    assert dataset.metadata["voltage"] == "magnitude" and dataset.metadata["lost_channels"] == [3]
    assert source_set(*job).dataset.metadata["voltage"] == "signed"


@pytest.mark.parametrize(
    ("stated", "place"),
    [
        ({"values": "difference"}, "values"),
        ({"position_frame": "robot"}, "position_frame"),
        ({}, "column touch"),
    ],
)
def test_what_no_estimator_is_trained_on_is_refused_and_not_recommended(folder, stated, place):
    recorded = recording.read(folder / "recording.parquet")
    frames = recorded.frames if stated else recorded.frames.assign(touch=False)
    other = replace(recorded, frames=frames, metadata=recorded.metadata | stated)
    with pytest.raises(InputError, match=place):
        source_set(Simulator.read(folder), other, 100, 1, PressPrior(FORCES, 8.0), "set")
    consistent = {"effects": [], "verdict": "consistent", "fit": {"last": None, "held_out": {}}}
    text, other_text = (
        answer._use(SimpleNamespace(diagnosis=consistent, recording=item))
        for item in (recorded, other)
    )
    assert "eitskin train" in text and "eitskin train" not in other_text


@pytest.mark.parametrize("count", ["samples", "epochs", "seeds"])
def test_a_count_below_one_is_refused(folder, count, capsys):
    assert cli.main(["train", str(folder), f"--{count}", "0"]) == 1
    assert f"{count}: found 0, expected 1 or more" in capsys.readouterr().err


def test_a_folder_without_evidence_and_a_target_of_another_board_are_refused(folder, tmp_path):
    recorded = recording.read(folder / "recording.parquet")
    recording.write(recorded, tmp_path / "recording.parquet")
    for name in ("effects.yaml", "diagnosis.json"):
        (tmp_path / name).write_text((folder / name).read_text())
    dataset = source_set(
        Simulator.read(folder), recorded, 100, 1, PressPrior(FORCES, 8.0), "set"
    ).dataset
    with pytest.raises(InputError, match="a diagnosis' evidence"):
        training._tests(recorded, tmp_path, None, dataset)
    turned = replace(
        recorded, metadata=recorded.metadata | {"channels": recorded.channels[::-1].tolist()}
    )
    with pytest.raises(InputError, match="target: channels"):
        training._tests(recorded, folder, turned, dataset)
    robot = replace(recorded, metadata=recorded.metadata | {"position_frame": "robot"})
    with pytest.raises(InputError, match="target: position_frame"):
        training._tests(recorded, folder, robot, dataset)


def test_of_a_target_only_what_is_usable_tests(folder):
    recorded = recording.read(folder / "recording.parquet")
    dataset = source_set(
        Simulator.read(folder), recorded, 100, 1, PressPrior(FORCES, 8.0), "set"
    ).dataset
    frames = pd.concat([recorded.frames, recorded.frames.iloc[-5:]], ignore_index=True)
    step_s = recorded.frames["time_s"].diff().median()
    frames["time_s"], frames["frame"] = step_s * np.arange(len(frames)), np.arange(len(frames))
    voltage = np.vstack([recorded.voltage, recorded.voltage[-5:]])
    sizes = []
    for target in (recorded, replace(recorded, frames=frames, voltage=voltage)):
        (test,), labelled = training._tests(recorded, folder, target, dataset)
        sizes.append(len(test.states) + len(labelled.states))
    assert sizes[0] == sizes[1]


def test_the_command_writes_and_answers(folder, tmp_path, capsys, monkeypatch):
    frame = training.trained(folder, plan=training.Plan(**SMALL | {"seeds": 1})).card
    monkeypatch.setattr(
        training,
        "trained",
        lambda *_: type("Answer", (), {"card": frame, "write": lambda _, out: [out]})(),
    )
    out = str(tmp_path / "out")
    assert cli.main(["train", str(folder), "--out", out, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["format"] == "eit-estimator" and answer["files"] == [out]
    assert cli.main(["train", str(folder), "--out", out]) == 0
    assert "one seed: no interval" in capsys.readouterr().out


def test_perturbations_are_those_of_a_configuration(tmp_path, capsys):
    command = ["train", "nowhere", "--perturbations", str(tmp_path / "other.yaml")]
    for text in ("configurations: {}", "configurations:", "configurations: {authors: 3}"):
        (tmp_path / "other.yaml").write_text(text)
        assert cli.main(command) == 1
        assert "configurations.authors.effects: found nothing" in capsys.readouterr().err
