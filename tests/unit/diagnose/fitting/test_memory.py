import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from eitskin import cli
from eitskin.data import recording
from eitskin.data.recording import Recording, frames_table, presses
from eitskin.diagnose.fitting.excerpt import LIMIT_GIB, MAX_FRAMES
from eitskin.diagnose.fitting.memory import GIB, MIN_FRAMES, Counts, frame_limit, peak_bytes
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate
from simulated_metadata import simulated_metadata
from small_skin import small_recording

ORDINARY = Counts(16, 208, True, 0)


def of_channels(electrodes, channels, frames, touched=True, **skin):
    """A recording with readings of 1 V; of every second frame a touch."""
    angles = tuple(even_angles(electrodes).tolist())
    owner = replace(Skin(80.0, 3.0, 0.5, angles, 5.0, 2e-3, 1e-3, 0.5), **skin)
    touch = touched & (np.arange(frames) % 2 == 1)
    table = frames_table(np.arange(frames), touch, 5.0, 5.0, 1.0, 8.0)
    metadata = simulated_metadata(owner, channels)
    return Recording(table, np.ones((frames, len(channels))), None, None, metadata)


def every_drive(electrodes):
    """(M, 4): every pair drives, adjacent ones are measured."""
    n = electrodes
    rows = [(a, b, k, (k + 1) % n) for a in range(n) for b in range(a) for k in range(n)]
    return np.array([row for row in rows if len({*row}) == 4])


@pytest.mark.parametrize("skin", [{}, {"touched": False}, {"touched": False, "thickness_mm": 40.0}])
def test_a_usual_recording_keeps_as_many_frames_as_ever(skin):
    assert frame_limit(of_channels(16, channel_table(16), 600, **skin)) == MAX_FRAMES


@pytest.mark.parametrize("limit", [1.5, 4.0, 16.0])
@pytest.mark.parametrize("electrodes", [16, 32])
def test_as_many_frames_as_fit_are_diagnosed(electrodes, limit):
    recorded = of_channels(electrodes, channel_table(electrodes), 600)
    counts = Counts.from_recording(recorded)
    if peak_bytes(counts, MIN_FRAMES) > limit * GIB:
        with pytest.raises(InputError):
            frame_limit(recorded, limit)
        return
    count = frame_limit(recorded, limit)
    assert peak_bytes(counts, count) <= limit * GIB
    assert (
        count == MAX_FRAMES or (peak_bytes(counts, np.arange(count + 1, 501)) > limit * GIB).all()
    )


@pytest.mark.parametrize(
    "more", [{"electrodes": 40}, {"channels": 416}, {"body_bytes": 1 << 29}, {"channels": 928}]
)
@pytest.mark.parametrize("frames", [20, 500])
def test_more_of_anything_takes_more(more, frames):
    assert peak_bytes(replace(ORDINARY, **more), frames) > peak_bytes(ORDINARY, frames)
    assert peak_bytes(ORDINARY, frames) > peak_bytes(replace(ORDINARY, touched=False), frames)


def test_too_many_channels_are_refused_in_a_sentence_that_says_how_many_may_be():
    channels = every_drive(32)
    with pytest.raises(InputError) as refused:
        frame_limit(of_channels(32, channels, 40), file="skin.parquet")
    said = str(refused.value)
    assert said.startswith("skin.parquet: memory: found 13920 channels of 32 electrodes, of which")
    assert "at most 4 GiB: a recording of " in said and "--memory GIB" in said
    most = int(said.split("a recording of ")[1].split(" channels")[0])
    assert 928 < most < len(channels)
    thinned = channels[np.linspace(0, len(channels) - 1, most).astype(int)]
    assert frame_limit(of_channels(32, thinned, 40)) >= MIN_FRAMES
    need = float(said.split("take up to ")[1].split(" GiB")[0])
    assert need > LIMIT_GIB
    assert frame_limit(of_channels(32, channels, 40), 1.01 * need) >= MIN_FRAMES


def test_a_short_recording_needs_no_more_frames_than_it_has():
    counts = Counts.from_recording(of_channels(32, every_drive(32)[::5], 2))
    enough = float(peak_bytes(counts, 2)) / GIB
    assert 2 <= frame_limit(of_channels(32, every_drive(32)[::5], 2), enough) < MIN_FRAMES


def test_a_body_of_good_contacts_takes_more_than_one_of_poor_ones():
    deep = {"thickness_mm": 40.0, "electrode_height_mm": 5.0}
    poor, good = (
        Counts.from_recording(
            of_channels(16, channel_table(16), 2, contact_impedivity_ohm_m2=z, **deep)
        )
        for z in (2e-3, 1e-4)
    )
    assert 0 < poor.body_bytes < good.body_bytes
    assert Counts.from_recording(of_channels(16, channel_table(16), 2)).body_bytes == 0


def test_the_command_refuses_before_anything_is_done(tmp_path, capsys, monkeypatch):
    path, out = tmp_path / "skin.parquet", tmp_path / "out"
    recording.write(small_recording(places=1), path)
    monkeypatch.setattr(cli.check, "check", lambda recorded: pytest.fail("work began"))
    command = ["diagnose", str(path), "--out", str(out), "--memory", "0.1"]
    assert cli.main(command) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1
    assert printed.err.startswith(f"{path}: memory: found 40 channels of 8 electrodes, of which")
    assert "at most 0.1 GiB: fewer electrodes, or more memory by --memory GIB" in printed.err
    assert not out.exists()


# What a process and those that it forks hold together, again and again.
MEASURED = """
import re, sys, threading
from pathlib import Path
from eitskin.data import recording
from eitskin.diagnose import diagnosis

own, peak, over = Path("/proc/self/task"), [0], threading.Event()

def held(process):
    try:
        found = Path(f"/proc/{process}/smaps_rollup").read_text()
    except OSError:
        return 0
    return 1024 * int(re.search(r"Pss:\\s+(\\d+) kB", found)[1])

def look():
    while not over.wait(0.1):
        forked = [one for task in own.iterdir() for one in (task / "children").read_text().split()]
        peak[0] = max(peak[0], sum(map(held, ["self", *forked])))

looking = threading.Thread(target=look)
looking.start()
diagnosis.diagnose(recording.read(sys.argv[1]), memory_GiB=float(sys.argv[2]))
over.set()
looking.join()
print(peak[0])
"""


# With the machine to itself:
# `python -m pytest -m rehearsal tests/unit/diagnose/fitting/test_memory.py`.
@pytest.mark.rehearsal
@pytest.mark.parametrize(
    ("electrodes", "frames", "skin"),
    [
        (16, 120, {}),
        (24, 60, {}),
        (32, 40, {}),
        (16, 20, {"thickness_mm": 40.0, "electrode_height_mm": 5.0, "electrode_z_mm": 18.0}),
    ],
)
def test_what_is_foretold_is_more_than_it_takes_but_not_by_far(tmp_path, electrodes, frames, skin):
    """A contact three times as poor; a body that nobody touches."""
    channels = channel_table(electrodes)
    recorded = of_channels(electrodes, channels, frames, not skin, **skin)
    contact = {"name": "contact-impedance", "electrodes": [3], "parameters": {"ratio": [3.0]}}
    item = {"name": "third-dimension"} if skin else contact
    rows = recorded.frames.iloc[:2]
    chosen = settings([item], site_counts(channels), (0, 0))
    clean = simulate(rows, presses(recorded)[:2], recorded.skin, channels, chosen, "train")
    draw = np.random.default_rng(0).normal(size=recorded.voltage.shape)
    clean = np.tile(clean, (frames // 2, 1))
    recorded.voltage = clean + 1e-3 * np.median(np.abs(clean)) * draw
    recording.write(recorded, tmp_path / "skin.parquet")
    command = [sys.executable, "-c", MEASURED, str(tmp_path / "skin.parquet"), "16"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    peak, most = int(run.stdout), peak_bytes(Counts.from_recording(recorded), frames)
    assert most / 4.0 < peak < most
