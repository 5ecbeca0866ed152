"""A Slurm of two nodes on this machine's loopback: no systemd, cgroups or accounting database."""

import os
import re
import secrets
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

DAEMONS = ("munged", "slurmctld", "slurmd")
COMMANDS = ("sbatch", "srun", "squeue", "scancel", "sinfo", "scontrol")
OF_SLURM = ("slurmctld", "slurmd", "slurmstepd")
SEARCHED = os.pathsep.join([os.environ["PATH"], "/usr/sbin"])
SCRIPTS = b"/.snakemake/scripts/"  # where Snakemake lays what it runs
SYSTEM_FILE = Path("/etc/slurm/slurm.conf")  # the executor's job steps know no other
OWNER = "owner.pid"  # of the process that ends the daemons, and when that began
MARK = "EITSKIN_SLURM"  # in the environment of all daemons: the folder of their cluster
ENDINGS = (signal.SIGTERM, signal.SIGHUP)  # besides Ctrl-C, which Python raises by itself
NODES = ("n1", "n2")
NAME = "loopback"
CONFIGURATION = """\
ClusterName={name}
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={port}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SlurmdParameters=config_overrides
SchedulerParameters=sched_interval=1,sched_min_interval=0
SlurmdTimeout=10
ReturnToService=2
MinJobAge=900
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool-%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd-%n.log
PartitionName=main Nodes=ALL Default=YES LLN=YES MaxTime=INFINITE State=UP
"""
# The executor asks `sacct` where `scontrol` is slow to answer, and loses its jobs where that fails,
# as it does without accounting. This one tells what squeue does.
SACCT = """\
#!/bin/sh
while [ $# -gt 1 ]; do [ "$1" = --name ] && name=$2; shift; done
exec squeue --noheader --states=all --format='%i|%T' --name "$name"
"""
NODE = """\
NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs=8 RealMemory=32000
"""


def obstacle() -> str | None:
    """Why no Slurm can be started here, in a sentence; None where one can."""
    lacking = [name for name in (*DAEMONS, *COMMANDS) if shutil.which(name, path=SEARCHED) is None]
    if lacking:
        packages = "slurmctld slurmd slurm-client munge"
        return f"this machine lacks {', '.join(lacking)}: apt-get install {packages}"
    if os.geteuid() != 0:
        return f"{SYSTEM_FILE} is root's alone to make"
    if _left_behind() is None:
        if SYSTEM_FILE.exists():
            return f"this machine has a Slurm already: {SYSTEM_FILE}"
        running = [pid for pid in _processes() if any(_is(pid, name) for name in OF_SLURM)]
        if running:  # its job steps cannot be told from those of a cluster of this module
            return f"this machine has a Slurm already: process {running[0]}"
    return None


def _left_behind() -> Path | None:
    """The folder of a cluster that a killed run has left, maybe with its daemons."""
    owner = SYSTEM_FILE.resolve().with_name(OWNER)
    if not owner.exists():
        return None
    pid, begin = owner.read_text().split()
    return None if _begin(int(pid)) == begin else owner.parent


class Cluster:
    """A Slurm that runs, its state and its logs in `folder`."""

    def __init__(self, folder: Path):
        self.folder = folder

    @property
    def environment(self) -> dict[str, str]:
        """What a program needs that submits to it."""
        return {"PATH": f"{self.folder / 'bin'}:{os.environ['PATH']}"}

    def jobs(self, node: str | None = None, state: str = "all") -> list[str]:
        """The numbers of its jobs, of one node or of all."""
        on = ["--nodelist", node] if node else []
        return _said("squeue", "--noheader", "--format=%i", f"--states={state}", *on).split()

    def node_states(self) -> dict[str, str]:
        """What the controller says of each node."""
        return dict(line.split() for line in _said("sinfo", "-hN", "-o", "%N %T").splitlines())

    def working(self) -> str | None:
        """A node on which a script of the workflow runs by now."""
        for node in NODES:
            jobs = self.jobs(node, "running")
            scripts = (p for p in Path("/proc").glob("[0-9]*") if SCRIPTS in _command(p))
            if any(_belongs(process, jobs) for process in scripts):
                return node
        return None

    def fail(self, node: str) -> list[str]:
        """End a node as a power cut does: its daemon and all that runs there. The jobs it had."""
        lost = self.jobs(node, "running")
        os.kill(_pid(self.folder / f"slurmd-{node}.pid"), signal.SIGKILL)
        _kill_jobs(lost)
        return lost


@contextmanager
def loopback(folder: Path) -> Iterator[Cluster]:
    """Start Slurm with its state in a new `folder`; at the end, whatever comes, end its daemons and
    its jobs and take its configuration out of /etc.

    Raises FileExistsError where there is an `obstacle`, TimeoutError with the controller's log
    where the nodes do not come up.
    """
    if reason := obstacle():
        raise FileExistsError(reason)
    if left := _left_behind():
        _stop(left)
    SYSTEM_FILE.unlink(missing_ok=True)  # also a link to nothing
    (folder / "state").mkdir(parents=True)
    (folder / OWNER).write_text(f"{os.getpid()} {_begin(os.getpid())}")
    key, file = folder / "munge.key", folder / "slurm.conf"
    key.write_bytes(secrets.token_bytes(128))
    key.chmod(0o600)
    file.write_text(_configuration(folder))
    (folder / "bin").mkdir()
    (folder / "bin" / "sacct").write_text(SACCT)
    (folder / "bin" / "sacct").chmod(0o755)
    SYSTEM_FILE.parent.mkdir(exist_ok=True)
    SYSTEM_FILE.symlink_to(file)
    cluster = Cluster(folder)
    before = {number: signal.signal(number, _end) for number in ENDINGS}
    try:
        _start(
            folder,
            "munged",
            "--force",
            f"--key-file={key}",
            f"--socket={folder}/munge.socket",
            f"--pid-file={folder}/munged.pid",
            f"--log-file={folder}/munged.log",
            f"--seed-file={folder}/munge.seed",
        )
        _start(folder, "slurmctld")
        for node in NODES:
            _start(folder, "slurmd", "-N", node)
        _wait_for_nodes(cluster)
        yield cluster
    finally:
        for number in (*ENDINGS, signal.SIGINT):  # nobody interrupts the end
            signal.signal(number, signal.SIG_IGN)
        _stop(folder)
        SYSTEM_FILE.unlink()
        for number, handler in {**before, signal.SIGINT: signal.default_int_handler}.items():
            signal.signal(number, handler)


def _end(*_) -> None:
    raise SystemExit("ended by a signal")


def _stat(pid: int | str) -> list[str]:
    """What /proc tells of a process behind its name, its state first; of one that is none: Z."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ["Z"]


def _begin(pid: int) -> str | None:
    """When a process began, in ticks since the start of the machine; None where it has ended."""
    return None if (stat := _stat(pid))[0] == "Z" else stat[19]


def _configuration(folder: Path) -> str:
    host = socket.gethostname().partition(".")[0]
    controller, *ports = _free_ports(1 + len(NODES))
    user = Path("/proc/self").owner()
    head = CONFIGURATION.format(name=NAME, host=host, port=controller, user=user, folder=folder)
    nodes = [NODE.format(name=n, host=host, port=p) for n, p in zip(NODES, ports, strict=True)]
    *lines, partition = head.splitlines(keepends=True)
    return "".join([*lines, *nodes, partition])


def _free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    try:
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]
    finally:
        for one in sockets:
            one.close()


def _start(folder: Path, daemon: str, *arguments: str) -> None:
    """Start a daemon, which goes to the background by itself."""
    command = [shutil.which(daemon, path=SEARCHED), *arguments]
    marked = os.environ | {MARK: str(folder)}
    subprocess.run(command, check=True, timeout=60, stdin=subprocess.DEVNULL, env=marked)


def _wait_for_nodes(cluster: Cluster) -> None:
    end = time.monotonic() + 60
    while set(cluster.node_states().values()) != {"idle"}:
        if time.monotonic() > end:
            raise TimeoutError((cluster.folder / "slurmctld.log").read_text()[-2000:])
        time.sleep(0.2)


def _stop(folder: Path) -> None:
    """End nodes, the controller, what they sign messages by, and whatever ran in jobs; also where
    no controller answers any more, and daemons that have not written their pid yet."""
    for name in (*(f"slurmd-{node}" for node in NODES), "slurmctld", "munged"):
        daemon = name.partition("-")[0]
        written = {_pid(folder / f"{name}.pid")}  # a daemon that has set its title hides its mark
        marked = {pid for pid in _processes() if f"{MARK}={folder}" in _environment(pid)}
        for pid in filter(None, written | marked):
            if _is(pid, daemon):
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGTERM)
                    _wait_for_end(pid)
    _kill_jobs(None)


def _environment(pid: int | str) -> list[str]:
    try:
        return Path(f"/proc/{pid}/environ").read_bytes().decode(errors="replace").split("\0")
    except OSError:  # it has ended meanwhile
        return []


def _pid(file: Path) -> int | None:
    return int(file.read_text()) if file.exists() else None


def _processes() -> list[int]:
    return [int(process.name) for process in Path("/proc").glob("[0-9]*")]


def _is(pid: int, name: str) -> bool:
    comm = Path(f"/proc/{pid}/comm")
    return comm.exists() and comm.read_text().strip() == name


def _wait_for_end(pid: int) -> None:
    end = time.monotonic() + 20
    while _stat(pid)[0] != "Z":
        if time.monotonic() > end:
            os.kill(pid, signal.SIGKILL)
            end = float("inf")
        time.sleep(0.1)


def _kill_jobs(jobs: list[str] | None) -> None:
    """Kill what runs in some jobs or in all, until nothing is left: a process may just have begun
    another."""
    while found := [p for p in Path("/proc").glob("[0-9]*") if _belongs(p, jobs)]:
        for process in found:
            with suppress(ProcessLookupError):
                os.kill(int(process.name), signal.SIGKILL)
        time.sleep(0.05)


def _command(process: Path) -> bytes:
    try:
        return (process / "cmdline").read_bytes()
    except OSError:  # it has ended meanwhile
        return b""


def _belongs(process: Path, jobs: list[str] | None) -> bool:
    """Whether a process is of one of some jobs, of any for None, or is the daemon of its step."""
    lines = _environment(process.name)
    told = dict(line.split("=", 1) for line in lines if line.startswith("SLURM_"))
    step = re.match(rb"slurmstepd: \[(\d+)\.", _command(process))
    if told.get("SLURM_CLUSTER_NAME") != NAME and not step:
        return False
    number = step[1].decode() if step else told.get("SLURM_JOB_ID")
    return _stat(process.name)[0] != "Z" and (jobs is None or number in jobs)


def _said(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout
