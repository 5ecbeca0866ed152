"""A copy of the workflow in a folder of its own, run as `make` runs it."""

import compileall
import csv
import gc
import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import durations

ROOT = Path(__file__).parents[2]
TINY = "tiny.yaml"
SCORE, TOOK = "results/concealed/demo/score/", "seconds"  # what a diagnosis took is in it
SAID = ("out", "err", "seconds")
PLANS = {"--dry-run", "--summary", "--detailed-summary"}
# Nothing of the workflow's own, which each copy has to itself.
LIBRARIES = [
    "snakemake.cli",
    "jsonschema",
    "pandas",
    "pyarrow.parquet",
    "scipy.io",
    "scipy.spatial",
]
# What the rules import of it.
OWN = [
    "eitskin.capture.attachment",
    "eitskin.configuration",
    "eitskin.paper.rows",
    "eitskin.provenance",
    "proof.blocks",
    "proof.real_sets",
]
FORKS = get_context("forkserver")
FORKS.set_forkserver_preload(LIBRARIES)


def plan(folder: str, environment: dict[str, str], arguments: list[str], *files: str):
    """Snakemake's command line, in a process that has its libraries already; what it prints, its
    messages and its processor seconds in three files."""
    out, err, seconds = files
    for file, descriptor in ((out, 1), (err, 2)):
        os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT), descriptor)
    os.chdir(folder)
    os.environ.update(environment)
    sys.path[:0] = ["", environment["PYTHONPATH"]]
    sys.argv = ["snakemake", *arguments]
    gc.freeze()  # the libraries are not searched for garbage again
    from snakemake import cli

    try:
        cli.main()
    finally:
        Path(seconds).write_text(str(sum(os.times()[:4])))


def plans(folder: str, environment: dict, arguments: list, edits: Sequence, said: str) -> None:
    """Plans after edits, one after the other and each without those before it, by forks of this
    process, which has the workflow's own modules as well; what plan k prints in `said`/k."""
    sys.path[:0] = [environment["PYTHONPATH"]]
    for name in OWN:
        import_module(name)
    for number, replacements in enumerate(edits):
        place = Path(said, str(number))
        place.mkdir()
        with House(Path(folder)).edited(replacements):
            child = os.fork()
            if child == 0:
                try:
                    plan(folder, environment, arguments, *(str(place / name) for name in SAID))
                finally:
                    sys.stdout.flush()
                    os._exit(0)
            os.waitpid(child, 0)


def summary(out: str, err: str) -> dict[str, bool]:
    """Of each file in what `--summary` prints, whether it is to be written anew."""
    header, *lines = [line.split("\t") for line in out.splitlines() if line] or [[]]
    assert lines, err
    plan, file = header.index("plan"), header.index("output_file")
    return {line[file]: line[plan] != "no update" for line in lines}


class House:
    """The workflow in `folder`, with the tiny configuration, importing the package from there."""

    def __init__(self, folder: Path):
        self.folder = folder

    @classmethod
    def build(cls, folder: Path) -> "House":
        """Copy what the repository holds of the workflow, and compile it: each of some hundred jobs
        and plans would do so."""
        folder.mkdir(parents=True)
        for name in ("Snakefile", "config.yaml"):
            shutil.copy(ROOT / name, folder)
        for name in ("workflow", "envs", "profiles"):
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, folder / name, ignore=ignored)
        shutil.copy(Path(__file__).with_name(TINY), folder)
        compileall.compile_dir(folder / "workflow", quiet=1)
        return cls(folder)

    def copy(self, folder: Path) -> "House":
        """The whole folder, results and Snakemake's records with it, times kept."""
        shutil.copytree(self.folder, folder, symlinks=True)
        return House(folder)

    def command(self, *arguments: str, cores: int = 2) -> list[str]:
        """Snakemake's command line with the tiny configuration."""
        snakemake = (sys.executable, "-m", "snakemake", "--cores", str(cores))
        return [*snakemake, "--configfile", TINY, *arguments]

    @property
    def environment(self) -> dict[str, str]:
        """This process's, with the package taken from the copy."""
        return os.environ | {"PYTHONPATH": str(self.folder / "workflow")}

    def snakemake(self, *arguments: str, cores: int = 2) -> subprocess.CompletedProcess:
        """Run to the end; output captured as text. Plans are made by forks (`forked`)."""
        if PLANS & set(arguments):
            return self.forked(*arguments, cores=cores)
        command = self.command(*arguments, cores=cores)
        return subprocess.run(
            command,
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
        )

    def forked(self, *arguments: str, cores: int = 2) -> subprocess.CompletedProcess:
        """A run that begins no job, by a fork of a process that has loaded Snakemake: to load it
        takes longer than to plan, or to refuse."""
        command = self.command(*arguments, cores=cores)
        with TemporaryDirectory() as said:
            files = [Path(said) / name for name in SAID]
            given = (str(self.folder), self.environment, command[3:], *map(str, files))
            process = FORKS.Process(target=plan, args=given)
            process.start()
            process.join()
            out, err, seconds = (file.read_text(encoding="utf-8") for file in files)
        durations.forked_seconds.append(float(seconds))
        return subprocess.CompletedProcess(command, process.exitcode, out, err)

    def edit(self, file: str, old: str, new: str) -> None:
        """Replace the one occurrence of `old` in a file."""
        path = self.folder / file
        text = path.read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in {file}"
        path.write_text(text.replace(old, new), encoding="utf-8")

    @contextmanager
    def edited(self, replacements: Sequence[tuple[str, str | None, str]]) -> Iterator[None]:
        """Texts replaced in files meanwhile, each there once; added at the end in place of None."""
        before = {file: (self.folder / file).read_bytes() for file, _, _ in replacements}
        for file, old, new in replacements:
            if old is None:
                with (self.folder / file).open("a", encoding="utf-8") as stream:
                    stream.write(new)
            else:
                self.edit(file, old, new)
        yield
        for file, content in before.items():
            (self.folder / file).write_bytes(content)

    def after(self, edits: Sequence[Sequence[tuple[str, str | None, str]]]) -> list[dict]:
        """After each of some edits of this finished run: whether the next run would write a file
        anew, by its path."""
        command = self.command("--summary")
        with TemporaryDirectory() as said:
            given = (str(self.folder), self.environment, command[3:], edits, said)
            process = FORKS.Process(target=plans, args=given)
            process.start()
            process.join()
            found = []
            for number in range(len(edits)):
                out, err, seconds = (Path(said, str(number), name).read_text() for name in SAID)
                durations.forked_seconds.append(float(seconds))
                found.append(summary(out, err))
        return found

    def pending(self) -> set[str]:
        """Output files that the next run would write anew."""
        found = self.snakemake("--summary")
        assert found.returncode == 0, found.stderr
        return {file for file, stale in summary(found.stdout, found.stderr).items() if stale}

    def jobs(self, *targets: str, files: Sequence[str] = ()) -> set[str]:
        """The rules of the jobs that the next run would do, `all` left out; with more configuration
        files."""
        plan = self.snakemake(*files, "--dry-run", "--quiet", "rules", "--", *targets)
        assert plan.returncode == 0, plan.stdout + plan.stderr
        lines = [line.split() for line in (plan.stdout + plan.stderr).splitlines()]
        named = {words[0] for words in lines if len(words) == 2 and words[1].isdigit()}
        return named - {"total", "all"}

    def digests(self) -> dict[str, str]:
        """SHA-256 of every result by its path; parts that a kill left behind are no results, and
        what a diagnosis took is never the same twice."""
        return {
            str(file.relative_to(self.folder)): hashlib.sha256(file.read_bytes()).hexdigest()
            for file in sorted((self.folder / "results").rglob("*"))
            if file.is_file() and file.suffix != ".part" and file.parent.name != "seconds"
        }

    def results(self) -> tuple[dict[str, str], list[dict]]:
        """The digest of every result, and the scored cases without the time that they took."""
        digests = {name: own for name, own in self.digests().items() if not name.startswith(SCORE)}
        with (self.folder / SCORE / "cases.csv").open(newline="") as file:
            cases = [{k: v for k, v in row.items() if k != TOOK} for row in csv.DictReader(file)]
        return digests, cases
