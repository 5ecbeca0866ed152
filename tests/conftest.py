"""Settings of every test: by default properties are tested on the same examples wherever and
whenever they are run; the profile `search` draws others, of the seed that it is given. `--shard`
runs a share of the tests, `--renew-durations` writes what tests cost (`durations.py`)."""

from collections import Counter

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers
from xdist.scheduler import LoadGroupScheduling

import durations

# Machines differ in speed, and so would what a health check of it says.
untimed = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("same", derandomize=True, database=None, print_blob=True, **untimed)
settings.register_profile(
    "search", derandomize=False, database=None, print_blob=True, max_examples=300, **untimed
)
settings.load_profile("same")

# Hypothesis draws constants of whatever modules are imported by then, by where they lie: examples
# would depend on the test before and on the folder's name.
providers.HypothesisProvider._local_constants = providers.Constants()


def pytest_addoption(parser):
    shards = ("all", "commit", *map(str, range(1, durations.SHARDS + 1)))
    parser.addoption("--shard", choices=shards, default="all", help="the share of the tests to run")
    parser.addoption("--renew-durations", choices=durations.RUNS, help="the column to renew")


def shard_number(config) -> int | None:
    """The shard that is asked for; None: all tests."""
    shard = config.getoption("shard")
    if shard == "commit":
        return durations.commit_shard()
    return None if shard == "all" else int(shard)


def pytest_report_header(config):
    if config.getoption("shard") != "all":
        return f"shard: {shard_number(config) or 'all'} of {durations.SHARDS}"


def group_of(item) -> str:
    """What stays together in a shard: tests that share one finished run; of the others a long test
    is alone, short ones are with those of their file."""
    shared = item.get_closest_marker("xdist_group")
    if shared:
        return shared.args[0]
    is_long = item.get_closest_marker("long") is not None
    return item.nodeid if is_long else durations.file_of(item.nodeid)


@pytest.hookimpl(trylast=True)  # of what -m and -k leave
def pytest_collection_modifyitems(config, items):
    """The tests of the shard; workers begin with files that take long, so that none ends late."""
    run = "test" if is_fast(config) else "long"
    seconds = durations.seconds_of((item.nodeid for item in items), run, durations.read())
    group_s, file_s = Counter(), Counter()
    for item in items:
        group_s[group_of(item)] += seconds[item.nodeid]
        file_s[durations.file_of(item.nodeid)] += seconds[item.nodeid]
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: -file_s[durations.file_of(item.nodeid)])
    shard = shard_number(config)
    if shard is not None:
        numbers = durations.shards(group_s)
        rest = [item for item in items if numbers[group_of(item)] != shard]
        config.hook.pytest_deselected(items=rest)
        items[:] = [item for item in items if numbers[group_of(item)] == shard]


def is_fast(config) -> bool:
    """Whether long tests are left out."""
    return "not long" in config.getoption("markexpr")


class ByFile(LoadGroupScheduling):
    """One worker runs a file's tests, and sets up its fixtures once; or those of a group."""

    def _split_scope(self, nodeid: str) -> str:
        return super()._split_scope(nodeid).partition("::")[0]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    config.option.loadscopereorder = False
    return ByFile(config, log) if is_fast(config) else LoadGroupScheduling(config, log)


SECONDS = pytest.StashKey[float]()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(item, call):
    """A report has the processor seconds since the report before it, of whatever test: fixtures
    of a session or module count to the test that they are set up for."""
    report = yield
    now_s = durations.processor_seconds()
    report.processor_s = now_s - item.config.stash.get(SECONDS, now_s)
    item.config.stash[SECONDS] = now_s
    return report


class Renewal:
    """Adds up what the tests of a run cost, and writes it at the end."""

    def __init__(self, run: str):
        self.run = run
        self.seconds: dict[str, float] = {}

    def pytest_runtest_logreport(self, report):
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.processor_s

    def pytest_sessionfinish(self):
        durations.renew(self.run, self.seconds)


def pytest_configure(config):
    run = config.getoption("renew_durations")
    if run and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Renewal(run))
