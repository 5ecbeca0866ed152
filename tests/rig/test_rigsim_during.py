"""A command while the emulated rig lives: whose exit code comes out, and whose the signals are."""

import contextlib
import os
import signal
import subprocess
import sys

import pytest
import yaml

from rigsim.ur import DASHBOARD_PORT, RTDE_PORT
from rigsim_process import configuration, free_host

UNKNOWN_PACKAGE = f"""
import contextlib, socket, sys
with socket.create_connection((sys.argv[1], {RTDE_PORT})) as robot:
    robot.sendall(bytes([0, 3, 0]))
    with contextlib.suppress(ConnectionError):
        robot.recv(1)
"""
LIFTING = f"""
import signal, socket, sys
signal.pthread_sigmask(signal.SIG_BLOCK, {{signal.SIGTERM}})
print("begun", flush=True)
signal.sigwait({{signal.SIGTERM}})
with socket.create_connection((sys.argv[1], {DASHBOARD_PORT})) as dashboard:
    print(dashboard.makefile().readline().strip(), flush=True)
sys.exit(7)
"""


@pytest.fixture
def config(tmp_path):
    """A rig on an address of its own."""
    served_configuration = configuration(tmp_path, host=free_host())
    (tmp_path / "rigsim.yaml").write_text(yaml.safe_dump(served_configuration), encoding="utf-8")
    return served_configuration


def during(tmp_path, *command):
    """Run it to its end."""
    return subprocess.run(
        [sys.executable, "-m", "rigsim.during", str(tmp_path / "rigsim.yaml"), *command],
        capture_output=True,
        text=True,
    )


def test_the_command_s_own_where_it_failed(config, tmp_path):
    run = during(tmp_path, "sh", "-c", f"test -L {config['load_cell']['link']} && exit 5")
    assert run.returncode == 5
    assert not (tmp_path / "load-cell").is_symlink()


def test_that_of_a_broken_rule_where_the_command_did_not(config, tmp_path):
    run = during(tmp_path, sys.executable, "-c", UNKNOWN_PACKAGE, config["host"])
    assert run.returncode == 3
    assert "the emulated rig ended with 3" in run.stderr


def test_sigterm_is_the_command_s_and_it_still_finds_the_rig(config, tmp_path):
    command = [sys.executable, "-c", LIFTING, config["host"]]
    with subprocess.Popen(
        [sys.executable, "-m", "rigsim.during", str(tmp_path / "rigsim.yaml"), *command],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as run:
        try:
            assert run.stdout.readline() == "begun\n"
            run.send_signal(signal.SIGTERM)
            assert run.wait() == 7
            assert run.stdout.read().startswith("Connected: Universal Robots")
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(run.pid, signal.SIGKILL)
    assert not (tmp_path / "load-cell").is_symlink()


def test_nothing_is_run_without_a_rig(config, tmp_path):
    (tmp_path / "rigsim.yaml").write_text("{}", encoding="utf-8")
    run = during(tmp_path, "touch", str(tmp_path / "it-ran"))
    assert run.returncode == 1
    assert not (tmp_path / "it-ran").exists()
