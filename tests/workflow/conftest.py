"""One finished run of the tiny workflow, shared by the tests of this folder."""

import pytest
from house import House


@pytest.fixture(scope="session")
def fresh(tmp_path_factory) -> House:
    """The workflow before its first run, its modules parsed; to be copied, not run or edited."""
    house = House.build(tmp_path_factory.mktemp("fresh") / "house")
    assert house.forked("--list-rules").returncode == 0
    return house


@pytest.fixture(scope="session")
def finished(fresh, tmp_path_factory) -> House:
    """The workflow after a run on two cores; not to be edited, but copied."""
    house = fresh.copy(tmp_path_factory.mktemp("finished") / "house")
    run = house.snakemake()
    assert run.returncode == 0, run.stdout + run.stderr
    return house
