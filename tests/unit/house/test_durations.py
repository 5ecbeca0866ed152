"""What tests cost, and the shares of the long ones that commits take in turn."""

import subprocess

import pytest

import durations

MEASURED = {
    "tests/unit/house/test_durations.py::test_a[1]": 0.3,
    "tests/unit/house/test_durations.py::test_a[2]@group": 0.4,
    "tests/unit/house/test_durations.py::test_b": 0.2,
}


def test_contributing_names_the_slowest_tests():
    page = durations.PAGE.read_text(encoding="utf-8")
    assert page == durations.page_with_slowest(page, durations.read())


def test_a_run_renews_its_column_of_the_files_that_it_tested(tmp_path):
    table = {
        "tests/unit/house/test_durations.py": {"test": 9.0, "long": 8.0},
        "tests/unit/house/test_durations.py::test_gone": {"test": 9.0},
        "tests/unit/house/test_errors.py": {"test": 3.0},
        "tests/unit/house/test_removed.py": {"test": 3.0},
    }
    path = tmp_path / "durations.csv"
    durations.write(durations.renewed(table, "test", MEASURED), path)
    assert durations.read(path) == {
        "tests/unit/house/test_durations.py": {"test": 0.9, "long": 8.0},
        "tests/unit/house/test_durations.py::test_a": {"test": 0.7},
        "tests/unit/house/test_errors.py": {"test": 3.0},
    }


def test_every_group_is_in_a_shard_and_shards_take_equally_long():
    seconds = {str(n): float(n) for n in range(1, 31)}
    numbers = durations.shards(seconds)
    assert numbers.keys() == seconds.keys()
    shard_s = dict.fromkeys(range(1, durations.SHARDS + 1), 0.0)
    for group, shard in numbers.items():
        shard_s[shard] += seconds[group]
    assert max(shard_s.values()) < 1.05 * min(shard_s.values())


def test_a_function_s_seconds_are_shared_by_its_tests():
    table = {"a.py::test_a": {"long": 6.0}, "a.py": {"long": 7.0}}
    nodeids = ["a.py::test_a[1]@group", "a.py::test_a[2]@group", "b.py::test_b"]
    seconds = durations.seconds_of(nodeids, "long", table)
    assert list(seconds.values()) == [3.0, 3.0, durations.SHORT_S]


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """An empty repository in place of this one, and a function that runs git in it."""
    monkeypatch.setattr(durations, "ROOT", tmp_path)
    for name in ("GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"):
        monkeypatch.delenv(name, raising=False)

    def git(*arguments):
        author = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
        subprocess.run(["git", *author, "-C", str(tmp_path), *arguments], check=True)

    return git


def test_commits_take_the_shards_in_turn(repository):
    repository("init", "-q")
    shards = set()
    for _ in range(durations.SHARDS):
        repository("commit", "-q", "--allow-empty", "-m", "a commit")
        shards.add(durations.commit_shard())
    assert shards == set(range(1, durations.SHARDS + 1))


def test_without_a_history_there_is_no_shard(repository):
    assert durations.commit_shard() is None
