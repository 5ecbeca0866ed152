"""How the workflow runs on one machine and on a cluster."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
import slurm
import yaml

ROOT = Path(__file__).parents[2]
PLANNED = """
import json
from pathlib import Path
from snakemake.api import SnakemakeApi
from snakemake.settings.types import ConfigSettings, DAGSettings, OutputSettings, Quietness
from snakemake.settings.types import ResourceSettings

with SnakemakeApi(OutputSettings(quiet={Quietness.ALL})) as api:
    workflow = api.workflow(
        resource_settings=ResourceSettings(cores=1),
        config_settings=ConfigSettings(configfiles=[Path("tiny.yaml")]),
        snakefile=Path("Snakefile"),
    )
    workflow.dag(DAGSettings(forceall=True, print_dag_as="dot")).printdag()
    print(json.dumps({rule.name: rule._group for rule in workflow._workflow.rules}))
"""


def profile(name):
    return yaml.safe_load((ROOT / "profiles" / name / "profile.yaml").read_text(encoding="utf-8"))


def test_a_cluster_runs_again_what_one_machine_would():
    for key in ("rerun-triggers", "rerun-incomplete", "resources"):
        assert profile("slurm")[key] == profile("default")[key]


def test_a_profile_has_one_file():
    """Of two the one would be read that one does not edit."""
    for folder in (ROOT / "profiles").iterdir():
        assert [file.name for file in folder.iterdir()] == ["profile.yaml"]


def test_the_slurm_executor_knows_what_the_profile_sets():
    plugin = pytest.importorskip("snakemake_executor_plugin_slurm")
    known = {f"slurm-{field.name.replace('_', '-')}" for field in fields(plugin.ExecutorSettings)}
    named = {key for key in profile("slurm") if key.startswith("slurm-")}
    assert named and named <= known
    assert "slurm-array-jobs" not in named  # they wait for one another


@pytest.fixture(scope="module")
def plan(fresh):
    """Of every job of the tiny workflow: its rule, its group, and the jobs that it waits for."""
    run = subprocess.run(
        [sys.executable, "-c", PLANNED],
        cwd=fresh.folder,
        env=fresh.environment,
        capture_output=True,
        text=True,
        check=True,
    )
    *dot, groups = run.stdout.splitlines()
    group_of = json.loads(groups)
    rules = dict(re.findall(r'^\s*(\d+)\[label = "([a-z_0-9]+)', "\n".join(dot), re.MULTILINE))
    edges = re.findall(r"^\s*(\d+) -> (\d+)$", "\n".join(dot), re.MULTILINE)
    return {
        job: (rule, group_of[rule], [before for before, after in edges if after == job])
        for job, rule in rules.items()
    }


def slurm_jobs(plan):
    """How many connected jobs of one group there are, and single ones of none."""
    joined = {job: job for job in plan}

    def root(job):
        return job if joined[job] == job else root(joined[job])

    for job, (_, group, waits_for) in plan.items():
        for before in waits_for:
            if group and plan[before][1] == group:
                joined[root(job)] = root(before)
    return {root(job) for job in plan}


def test_what_takes_seconds_is_grouped(plan):
    assert len(plan) > 50
    assert len(slurm_jobs(plan)) < len(plan) / 1.5


def test_no_rule_of_a_group_stands_before_the_group(plan):
    """A job on a cluster may make whatever the rules of its group make. What an edit meanwhile has
    made stale must not lie before it, outside of its group: several jobs would make it at once."""

    def allowed(job):
        rule, group, _ = plan[job]
        return group or rule

    def before(job, left):
        for one in plan[job][2]:
            yield one, left or allowed(one) != own
            yield from before(one, left or allowed(one) != own)

    for job in plan:
        own = allowed(job)
        for one, left in before(job, left=False):
            assert not left or allowed(one) != own, (plan[job], plan[one])
            assert left or plan[job][1], (plan[job], plan[one])


def test_a_machine_without_slurm_is_told_what_it_lacks(monkeypatch):
    monkeypatch.setattr(slurm, "SEARCHED", "")
    lacking = slurm.obstacle()
    assert re.fullmatch(r"this machine lacks munged, .*scontrol: apt-get install .*", lacking)


# Daemons that stand in for Slurm's: they go to the background, and two never write their pid.
DAEMON = """#!/bin/sh
cp /bin/sleep {folder}/{name}.d/{name} 2>/dev/null
{folder}/{name}.d/{name} 1000 >/dev/null 2>&1 &
[ {name} = munged ] && echo $! > {folder}/slurm/munged.pid
exit 0
"""
CLUSTER = """
import signal, sys, time
from pathlib import Path
import slurm
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's job has ignored
folder = Path(sys.argv[1])
slurm.SEARCHED, slurm.SYSTEM_FILE = f"{folder}/bin:{slurm.SEARCHED}", folder / "etc" / "slurm.conf"
slurm.COMMANDS, slurm.OF_SLURM, slurm.os.geteuid = (), (), lambda: 0
slurm._wait_for_nodes = lambda cluster: None
with slurm.loopback(folder / sys.argv[2]):
    print("running", flush=True)
    time.sleep(float(sys.argv[3]))
"""


@pytest.mark.parametrize("ending", ["SIGTERM", "SIGINT", "SIGHUP", "SIGKILL"])
def test_daemons_end_with_their_cluster_however_it_ends(tmp_path, ending):
    (tmp_path / "bin").mkdir()
    for name in slurm.DAEMONS:
        (tmp_path / f"{name}.d").mkdir()
        daemon = tmp_path / "bin" / name
        daemon.write_text(DAEMON.format(folder=tmp_path, name=name))
        daemon.chmod(0o755)

    def cluster(name, seconds):
        command = [sys.executable, "-c", CLUSTER, str(tmp_path), name, str(seconds)]
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
        return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE)

    def daemons():
        marks = f"{slurm.MARK}={tmp_path}"
        alive = [pid for pid in slurm._processes() if slurm._begin(pid)]
        return [pid for pid in alive if any(e.startswith(marks) for e in slurm._environment(pid))]

    first = cluster("slurm", 1000)
    assert first.stdout.readline() == b"running\n" and len(daemons()) == 4
    first.send_signal(getattr(signal, ending))
    first.wait(60)
    if ending == "SIGKILL":  # the next one does it
        assert len(daemons()) == 4
        assert cluster("next", 0).wait() == 0
    assert daemons() == []
    assert not (tmp_path / "etc" / "slurm.conf").is_symlink()
