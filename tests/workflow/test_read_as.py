"""What a file does not say of its channels, said in the configuration."""

import numpy as np
import pytest
import scipy.io

from eitskin.data import recording
from eitskin.data.channel_order import in_order
from eitskin.physics.protocol import channel_table
from homogeneous_skin import readings
from small_skin import small_recording

pytestmark = pytest.mark.xdist_group("refusals")


@pytest.mark.long
def test_a_recordings_order_and_pairs_are_the_importers(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    order = "drive-plus-ascending-own"
    table = in_order("", order, channel_table(16, "skip-2", "skip-2"), 16)
    scipy.io.savemat(house.folder / "mine.mat", {"v": readings(table, 16)[:, None]})
    said = f"{{path: mine.mat, drive: skip-2, measure: skip-2, order: {order}}}"
    (house.folder / "extra.yaml").write_text(f"recordings: {{my-skin: {said}}}\n")
    target = "results/recordings/my-skin.check.txt"
    run = house.snakemake("extra.yaml", "--", target)
    assert run.returncode == 0, run.stderr
    made = recording.read(house.folder / "results" / "recordings" / "my-skin.parquet")
    np.testing.assert_array_equal(made.channels, table)
    assert (house.folder / target).read_text().endswith("Usable.\n")
    (house.folder / "extra.yaml").write_text(
        "recordings: {my-skin: {path: mine.mat, order: upwards}}\n"
    )
    run = house.forked("extra.yaml", "--", target)
    assert run.returncode != 0 and "Traceback" not in run.stderr
    assert "extra.yaml: recordings.my-skin.order: found 'upwards', expected one of" in run.stderr


@pytest.mark.long
def test_some_of_a_recordings_frames_are_a_recording_of_their_own(fresh, tmp_path):
    house = fresh.copy(tmp_path / "house")
    whole = small_recording()
    recording.write(whole, house.folder / "skin.parquet")
    said = "{path: skin.parquet, frames: [4, 19]}"
    (house.folder / "extra.yaml").write_text(f"recordings: {{later: {said}}}\n")
    run = house.snakemake("extra.yaml", "--", "results/recordings/later.parquet")
    assert run.returncode == 0, run.stderr
    made = recording.read(house.folder / "results" / "recordings" / "later.parquet")
    np.testing.assert_array_equal(made.voltage, whole.voltage[4:20])
    (house.folder / "extra.yaml").write_text(
        "recordings: {later: {path: skin.parquet, frames: 4:19}}\n"
    )
    run = house.forked("extra.yaml", "--", "results/recordings/later.parquet")
    assert run.returncode != 0 and "Traceback" not in run.stderr
    assert "extra.yaml: recordings.later.frames: found " in run.stderr
    assert "expected a list" in run.stderr
