"""Stages are written and read a group of whole sessions at a time, however many they are."""

import tracemalloc

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from eitskin.data import dataset, parquet
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from eitskin.simulate import sets, stages
from eitskin.simulate.stages import Part, Stage

CHANNELS = channel_table(16)
GAIN = {"name": "force-dependent-gain", "parameters": {"per_N": {"sd": 0.01}, "F_mid_N": 5.0}}
FRAMES = 30  # of a session


def parts(sessions):
    """Sessions of a set that nobody has simulated."""
    for session in range(sessions):
        rng = np.random.default_rng(session)
        own = np.arange(FRAMES) + session * FRAMES
        table = pd.DataFrame({"sample": own, "session": session, "place": own})
        table[["x_mm", "y_mm"]] = rng.uniform(-50.0, 50.0, (FRAMES, 2))
        table["force_N"], table["probe_mm"] = rng.uniform(0.0, 10.0, FRAMES), 16.0
        untouched = 1e-3 * rng.normal(size=(1, len(CHANNELS))).repeat(FRAMES, axis=0)
        touched = untouched + 1e-5 * rng.normal(size=untouched.shape)
        yield Part(table, untouched.astype(np.float32), touched.astype(np.float32))


def made(folder, sessions):
    """A stage, the next with an effect, and the data set of it."""
    files = [folder / name for name in ("0.parquet", "1.parquet", "set.parquet")]
    stages.write(files[0], parts(sessions), CHANNELS, 10.0)
    sets.write_stage(files[0], files[1], 1, GAIN, 1)
    sets.write_dataset(files[1], files[2], "authors", 1, 0.01, "averaged")
    return files


def test_a_stage_is_read_as_it_was_written(tmp_path, monkeypatch):
    monkeypatch.setattr(stages, "ROWS", 2 * FRAMES)
    stages.write(tmp_path / "0.parquet", parts(5), CHANNELS, 10.0)
    stage = Stage(tmp_path / "0.parquet")
    assert np.array_equal(stage.channels, CHANNELS) and stage.force_max_N == 10.0
    assert [len(part.table) for part in stage] == [2 * FRAMES, 2 * FRAMES, FRAMES]
    assert len(stage) == 3
    given = list(parts(5))
    for index, found in enumerate(stage.joined()):
        wanted = [one[index] for one in given]
        if index == 0:
            assert found.equals(pd.concat(wanted, ignore_index=True))
        else:
            assert np.array_equal(found, np.concatenate(wanted))


def test_a_set_is_the_same_in_one_group_and_in_many(tmp_path, monkeypatch):
    found = []
    for rows in (stages.ROWS, FRAMES):
        monkeypatch.setattr(stages, "ROWS", rows)
        (tmp_path / str(rows)).mkdir()
        file = made(tmp_path / str(rows), 6)[-1]
        found.append((dataset.read(file), pq.ParquetFile(file).num_row_groups))
    (one, groups), (other, many) = found
    assert (groups, many) == (1, 6)
    assert one.table.equals(other.table) and np.array_equal(one.delta_V, other.delta_V)
    assert one.metadata == other.metadata and one.metadata["untouched"]["frames"] == 6 * FRAMES


def test_the_noise_is_told_from_the_first_samples(tmp_path, monkeypatch):
    monkeypatch.setattr(stages, "ROWS", FRAMES)
    monkeypatch.setattr(sets, "NOISE_SAMPLES", 3 * FRAMES)
    assert dataset.read(made(tmp_path, 6)[-1]).metadata["untouched"]["frames"] == 3 * FRAMES


def test_memory_does_not_grow_with_the_samples(tmp_path, monkeypatch):
    monkeypatch.setattr(stages, "ROWS", 4 * FRAMES)
    monkeypatch.setattr(sets, "NOISE_SAMPLES", 4 * FRAMES)
    made(tmp_path, 4)  # what is read in at first does not count
    peaks = []
    for sessions in (8, 80):
        largest, written = [], parquet.pq.ParquetWriter.write_table

        def noted(*given, largest=largest, written=written, **options):
            largest.append(pa.total_allocated_bytes())
            return written(*given, **options)

        monkeypatch.setattr(parquet.pq.ParquetWriter, "write_table", noted)
        tracemalloc.start()
        made(tmp_path, sessions)
        peaks.append((tracemalloc.get_traced_memory()[1], max(largest)))
        tracemalloc.stop()
        monkeypatch.setattr(parquet.pq.ParquetWriter, "write_table", written)
    (few, few_of_arrow), (many, many_of_arrow) = peaks
    assert many < 1.3 * few and many_of_arrow < 1.3 * few_of_arrow


def test_any_reader_finds_what_stands_beside_a_set(tmp_path):
    for file, key in zip(made(tmp_path, 2)[1:], (stages.KEY, dataset.SCHEMA_KEY), strict=True):
        assert key in pq.read_schema(file).metadata and key in pq.read_table(file).schema.metadata


def test_samples_fall_in_no_set(tmp_path):
    first, second = ((one.table.assign(depth_mm=np.nan), one.touched) for one in parts(2))
    metadata = dataset.read(made(tmp_path, 1)[-1]).metadata
    for given, found in (((second, first), "a fall"), ((), "none")):
        with pytest.raises(InputError, match=f"found {found}, expected"):
            dataset.write_parts(given, metadata, tmp_path / "other.parquet")
    assert not (tmp_path / "other.parquet").exists()


def test_another_parquet_file_is_no_stage(tmp_path):
    file = made(tmp_path, 1)[-1]
    with pytest.raises(InputError, match="no key eitskin-stage, expected a stage's metadata"):
        Stage(file)
