import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin.data import splits
from eitskin.errors import InputError


def table(session, place):
    return pd.DataFrame({"sample": np.arange(len(session)), "session": session, "place": place})


def uneven(draw_seed, n_groups):
    """A table whose places and sessions have between 1 and 30 samples each, in mixed order."""
    draw = np.random.default_rng(draw_seed)
    place = np.repeat(np.arange(n_groups), draw.integers(1, 31, n_groups))
    session = np.repeat(np.arange(n_groups), draw.integers(1, 31, n_groups))
    n = min(len(place), len(session))
    place, session = draw.permutation(place)[:n], draw.permutation(session)[:n]
    return table(session, place)


@given(st.integers(0, 10_000), st.integers(5, 60), st.integers(0, 99))
@pytest.mark.parametrize("kind", ["random", "place", "session"])
def test_no_group_is_in_two_parts_and_every_sample_is_in_one(kind, draw_seed, n_groups, seed):
    rows = uneven(draw_seed, n_groups)
    if rows[splits.GROUPS[kind]].nunique() < 3:
        return
    part = splits.assign(rows, kind, seed)
    assert set(part) == {"train", "validation", "test"}
    assert (pd.Series(part).groupby(rows[splits.GROUPS[kind]].to_numpy()).nunique() == 1).all()


@given(st.integers(0, 10_000), st.integers(30, 60), st.integers(0, 99))
@pytest.mark.parametrize("kind", ["place", "session"])
def test_shares_are_met_to_within_half_of_the_largest_group(kind, draw_seed, n_groups, seed):
    rows = uneven(draw_seed, n_groups)
    largest = rows[splits.GROUPS[kind]].value_counts().max()
    part = splits.assign(rows, kind, seed)
    remaining = (part != "test").sum()
    assert abs((part == "test").sum() - 0.2 * len(rows)) <= largest / 2
    assert abs((part == "validation").sum() - 0.2 * remaining) <= largest / 2


def test_random_split_has_the_papers_shares_and_mixes_places():
    rows = table(np.arange(1000) // 100, np.arange(1000) % 10)
    part = splits.assign(rows, "random", 3)
    assert [(part == name).sum() for name in splits.PARTS] == [640, 160, 200]
    assert rows["place"][part == "test"].nunique() == 10


def test_a_continuous_split_holds_out_sessions_of_samples_each_at_its_own_place():
    rows = table(np.arange(1000) // 50, np.arange(1000))
    part = splits.assign(rows, "continuous", 3)
    assert (part == splits.assign(rows, "session", 3)).all()
    assert (part == "test").sum() == 200
    with pytest.raises(InputError, match="places pressed again"):
        splits.assign(table(np.arange(1000) // 50, np.arange(1000) // 2), "continuous", 3)


def test_same_seed_same_parts_another_seed_others():
    rows = uneven(5, 40)
    first_split = splits.assign(rows, "place", 1)
    assert (first_split == splits.assign(rows, "place", 1)).all()
    assert (first_split != splits.assign(rows, "place", 2)).any()


def test_one_session_cannot_be_split_by_session():
    rows = table(np.zeros(100, int), np.arange(100) % 9)
    with pytest.raises(InputError, match=r"session.*1 group.*at least 3"):
        splits.assign(rows, "session", 1)


def test_unknown_kind_is_refused():
    with pytest.raises(InputError, match="'frame', expected one of random, place, session"):
        splits.assign(uneven(5, 40), "frame", 1)


def test_file_round_trip_is_byte_repeatable_and_belongs_to_its_dataset(tmp_path):
    rows = uneven(5, 40)
    part = splits.assign(rows, "place", 1)
    splits.write(tmp_path / "a.parquet", rows, part)
    splits.write(tmp_path / "b.parquet", rows, part)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    assert (splits.read(tmp_path / "a.parquet", rows) == part).all()
    with pytest.raises(InputError, match="other samples"):
        splits.read(tmp_path / "a.parquet", rows.iloc[1:])
    (tmp_path / "cut.parquet").write_bytes((tmp_path / "a.parquet").read_bytes()[:200])
    with pytest.raises(InputError, match=r"cut\.parquet"):
        splits.read(tmp_path / "cut.parquet", rows)
