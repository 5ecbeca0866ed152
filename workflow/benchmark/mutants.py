"""`python -m benchmark.mutants benchmarks/mutants.yaml [NAME ...]` makes rules that decide wrong,
one by one in a copy of the project, and says whether tests notice.

A mutant is killed if its tests fail, or if the rule is no longer there; it survives if they pass.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

from eitskin.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("workflow", "tests", "docs", "envs", "Snakefile", "config.yaml", "pyproject.toml")
PASSED, FAILED = 0, 1  # exit codes of pytest


def fate(mutant: dict, copy: Path) -> str:
    """ "killed", "survived" or "gone" of a mutant in a copy of the project; the copy's file is as
    before afterwards. Raises InputError where its text is not unique, or its tests do not run."""
    path = copy / mutant["file"]
    content = path.read_text("utf-8") if path.is_file() else ""
    count = content.count(mutant["text"])
    if count == 0:
        return "gone"
    if count > 1:
        raise InputError(mutant["file"], mutant["name"], f"its text {count} times", "once")
    environment = {**os.environ, "PYTHONPATH": str(copy / "workflow"), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider"]
    path.write_text(content.replace(mutant["text"], mutant["mutant"]), "utf-8")
    try:
        run = subprocess.run(
            [*command, *mutant["tests"]], cwd=copy, env=environment, capture_output=True, text=True
        )
    finally:
        path.write_text(content, "utf-8")
    if run.returncode not in (PASSED, FAILED):
        raise InputError(mutant["file"], mutant["name"], run.stdout[-500:], "tests that run")
    return "killed" if run.returncode == FAILED else "survived"


def main(path: Path, names: list[str]) -> int:
    """Print the fate of every mutant in a file, or of those of some names; 1 where one survives."""
    mutants = yaml.safe_load(path.read_text("utf-8"))
    survivors = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                ignored = shutil.ignore_patterns("__pycache__")
                shutil.copytree(source, copy / name, ignore=ignored)
            else:
                shutil.copy(source, copy / name)
        batch = [mutant for mutant in mutants if not names or mutant["name"] in names]
        for mutant in batch:
            outcome = fate(mutant, copy)
            survivors += outcome == "survived"
            print(f"{outcome}: {mutant['name']}", flush=True)
    print(f"{len(batch) - survivors} of {len(batch)} killed")
    return int(survivors > 0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
