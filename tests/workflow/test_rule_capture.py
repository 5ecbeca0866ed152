"""A rig in the workflow: `capture` moves the robot, nothing else does, and what it captured is a
recording like any other."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import yaml

from eitskin.capture import journal
from eitskin.capture.attachment import manifest_path
from eitskin.capture.press_plan import contacts, plan_sha256
from eitskin.configuration import captured_path
from eitskin.data import recording
from rigsim_process import free_host

pytestmark = pytest.mark.xdist_group("capture")

DEMO = "workflow/config/demo_capture.yaml"
NAME = "emulated-rig"
DIAGNOSIS = f"results/diagnosis/{NAME}/diagnosis.json"
REPORT = f"results/diagnosis/{NAME}/report.html"
AGAIN = ("sh", "-c", '"$@" || "$@" || "$@"', "sh")
QUICK = {  # fewer and shorter ways than the demo's, and one row
    "rig": {
        "pose": {"centre": [-0.593, -0.201, -0.096, 0.0, 3.142, 0.0]},  # 1 mm above the gel
        "plan": {
            "untouched_frames": 1,
            "step_mm": 3.0,
            "target_N": [0.8, 1.2],
            "settle_s": 0.01,
        },
    },
    "table_1": {"configurations": {"tiny": []}, "recordings": {NAME: {"place": ["mlp"]}}},
}
LATE = {"robot clock", "robot program", "late", "load cell silent"}  # what a busy machine causes


def test_whatever_is_asked_for_only_capture_captures(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    targets = ("all", "loop", "transfer", "table_2", "figure_1")
    planned = house.jobs(*targets, files=[DEMO, "--forceall"])
    assert {"import_recording", "loop"} <= planned and "capture" not in planned
    refused = house.snakemake(DEMO, "--dry-run", "--", REPORT)  # it moves no robot either
    assert refused.returncode != 0 and "No rule to produce" in refused.stderr + refused.stdout


def test_what_is_captured_is_never_captured_again(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    rig = yaml.safe_load((house.folder / DEMO).read_text(encoding="utf-8"))["rig"]
    place = house.folder / captured_path(NAME)
    place.parent.mkdir(parents=True)
    place.touch()
    said = json.dumps({"plan_sha256": plan_sha256(rig)})
    (house.folder / manifest_path(NAME)).write_text(said, encoding="utf-8")
    for module in ("eitskin/capture/session.py", "scripts/capture.py"):
        with (house.folder / "workflow" / module).open("a", encoding="utf-8") as file:
            file.write("\nUNUSED = 1\n")
    planned = house.jobs("all", REPORT, files=[DEMO, "--forceall"])
    assert {"check", "diagnose", "record_dataset"} <= planned
    assert "capture" not in planned
    again = house.snakemake(DEMO, "--forcerun", "capture", "--", "capture")
    assert again.returncode == 0, again.stderr
    assert not (house.folder / "captures").exists()


@pytest.mark.long
def test_a_capture_becomes_rows_of_table_1_and_a_diagnosis(fresh, tmp_path):
    """24 places with 3 probes, by the real libraries. Where the machine gives the driver no time
    the arm is stopped, as it should be, and the same command goes on."""
    pytest.importorskip("rtde_control", reason="ur_rtde is not installed: extra `rig`")
    house = on_a_host_of_its_own(fresh.copy(tmp_path / "house"))
    # Few frames show less: what is concealed is twice the demo's.
    house.edit("workflow/config/rigsim.yaml", "ratio: 2.0", "ratio: 4.0")
    (house.folder / "quick.yaml").write_text(yaml.safe_dump(QUICK), encoding="utf-8")
    run = during(house, [*AGAIN, *house.command(DEMO, "quick.yaml", "--", "capture")])
    assert run.returncode == 0 and stops(house) <= LATE, run.stdout + run.stderr
    assert_every_press_is_the_emulator_s(house)
    assert {event["frequency"] for event in named(house, "setWatchdog")} == {2.5}
    run = house.snakemake(DEMO, "quick.yaml", "--", "table_1", DIAGNOSIS)
    assert run.returncode == 0, run.stdout + run.stderr
    table = pd.read_csv(house.folder / "results" / "tables" / "table_1.csv")
    row = table[(table[["recording", "target", "metric"]] == [NAME, "x", "mae"]).all(axis=1)]
    rows = [["place", "mlp"], ["place", "mlp-ensemble"]]
    assert row[["split", "model"]].to_numpy().tolist() == rows
    assert row["mean"].between(0.0, 60.0, inclusive="neither").all()
    said = json.loads((house.folder / DIAGNOSIS).read_text(encoding="utf-8"))
    found = {effect["name"]: effect for effect in said["effects"]}
    assert found.keys() == {"contact-impedance", "measurement-gain"}
    assert found["contact-impedance"]["electrodes"] == [5]
    gain = found["measurement-gain"]
    values = np.atleast_1d(gain["parameters"]["gain"]["value"])
    gains = dict(zip(gain["measures"], values, strict=True))
    assert gains.pop(11) == pytest.approx(1.02, abs=1e-3)
    # Noise is another each time: now and then an amplifier's few 1e-4 are named as well.
    assert all(value == pytest.approx(1.0, abs=1e-3) for value in gains.values())


@pytest.mark.rehearsal
def test_ctrl_c_lifts_the_arm_and_the_same_command_goes_on(fresh, tmp_path):
    pytest.importorskip("rtde_control", reason="ur_rtde is not installed: extra `rig`")
    house = on_a_host_of_its_own(fresh.copy(tmp_path / "house"))
    small = house.folder / "small.yaml"
    small.write_text("rig: {plan: {radii: 1, angles: 3, probes_mm: [10.0]}}\n", encoding="utf-8")
    command = house.command(DEMO, small.name, "--", "capture")
    with emulated(house) as emulator:
        capture = subprocess.Popen(
            command,
            cwd=house.folder,
            env=house.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        while not named(house, "touched"):
            with contextlib.suppress(subprocess.TimeoutExpired):
                raise AssertionError(capture.communicate(timeout=0.05))
        os.killpg(capture.pid, signal.SIGINT)
        said, _ = capture.communicate()
        assert capture.returncode != 0 and "signal 2; stopped by stopL; lifted off" in said, said
        assert stops(house) == {"signal"}
        height_m = yaml.safe_load((house.folder / DEMO).read_text())["rig"]["pose"]["centre"][2]
        assert named(house, "still")[-1]["pose"][2] == pytest.approx(height_m, abs=1e-4)
        assert house.snakemake("--unlock").returncode == 0
        again = subprocess.run([*AGAIN, *command], cwd=house.folder, env=house.environment)
        assert again.returncode == 0
        emulator.stdin.close()
        assert emulator.wait() == 0
    touched = recording.read(house.folder / captured_path(NAME)).frames.query("touch")
    assert touched["contact"].unique().tolist() == [0, 1, 2]
    assert_made_again_from_the_journal(house, DEMO, small.name)


@contextlib.contextmanager
def emulated(house):
    """The emulated rig, listening."""
    with subprocess.Popen(
        [sys.executable, "-m", "rigsim", "workflow/config/rigsim.yaml"],
        cwd=house.folder,
        env=house.environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as process:
        assert process.stdout.readline()
        yield process


def named(house, event):
    """What the emulator has logged under one name."""
    log = (house.folder / "results" / "rig" / "events.jsonl").read_text(encoding="utf-8")
    whole = [line for line in log.splitlines(keepends=True) if line.endswith("\n")]
    return [entry for entry in map(json.loads, whole) if entry["event"] == event]


def on_a_host_of_its_own(house):
    """The same house, its rig on an address that nobody else uses."""
    host = f"host: {free_host()}"
    for file in ("workflow/config/rigsim.yaml", DEMO):
        house.edit(file, "host: 127.0.0.2", host)
    return house


def during(house, command):
    """A command while the emulated rig lives; the exit code tells of rules broken as well."""
    return subprocess.run(
        [sys.executable, "-m", "rigsim.during", "workflow/config/rigsim.yaml", *command],
        cwd=house.folder,
        env=house.environment,
        capture_output=True,
        text=True,
    )


def assert_made_again_from_the_journal(house, *files):
    """The same bytes without a rig, after `make clean`."""
    paths = [house.folder / file for file in (captured_path(NAME), manifest_path(NAME))]
    before = [path.read_bytes() for path in paths]
    shutil.rmtree(house.folder / "results")
    again = house.snakemake(*files, "--", "capture")
    assert again.returncode == 0, again.stdout + again.stderr
    assert [path.read_bytes() for path in paths] == before


def stops(house):
    """Why runs of the capture ended early."""
    found = journal.read(house.folder / "captures" / f"{NAME}.jsonl").records
    return {record["reason"] for record in found if record["kind"] == "stop"}


def assert_every_press_is_the_emulator_s(house):
    """Every place with every probe is in the recording, from a press that the emulator felt."""
    plan = yaml.safe_load((house.folder / DEMO).read_text(encoding="utf-8"))["rig"]["plan"]
    planned = contacts(plan)
    assert len(planned) == 24 * 3
    recorded = recording.read(house.folder / captured_path(NAME))
    assert recorded.metadata["source"] == "emulated rig"
    touched = recorded.frames[recorded.frames["touch"]]
    assert touched["contact"].unique().tolist() == [contact.number for contact in planned]
    felt = named(house, "touched")
    manifest = json.loads((house.folder / manifest_path(NAME)).read_text(encoding="utf-8"))
    assert len(felt) - len(planned) <= len(manifest["stops"])
    places = {(round(e["x_mm"]), round(e["y_mm"]), e["probe_mm"]) for e in felt}
    assert places == {(round(c.x_mm), round(c.y_mm), c.probe_mm) for c in planned}
