"""The tutorials run: their files are written, their commands run in order, and what they quote is
what is printed.

Of a page's fenced blocks, `python` and `yaml` are files, named in their first line, `diff` changes
files, `sh` is run, and `text` after it is what that printed, `…` standing for anything. A block
after `<!-- long -->` is run by the long tests alone, with what it printed; one after a paragraph
that begins `Not run by the tests:` is not run.
"""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from rigsim_process import free_host

ROOT = Path(__file__).parents[3]
HOST = free_host()
FOLDER = ROOT / "docs" / "tutorials"
PAGES = [*sorted(FOLDER.glob("*.md")), ROOT / "docs" / "python.md"]
FENCE = re.compile(r"^```(\w*|{eval-rst})\n(.*?)^```$", re.DOTALL | re.MULTILINE)
LONG, NOT_RUN = "<!-- long -->", "Not run by the tests: "
KINDS = ("python", "yaml", "diff", "sh", "text")
REFERENCE = "{eval-rst}"  # which Sphinx alone reads
LIMIT_S = 1800
LEFT_OUT = {
    "a_new_board": ["eitskin rig check my-rig.yaml"],
    "a_tank_with_its_drawing": [
        "eitskin diagnose captures/tank.parquet --skin captures/tank_unknown.yaml"
        " --out captures/tank-unknown"
    ],
}


@dataclass(frozen=True)
class Block:
    """A fenced block: its kind and text; whether it is long, and whether it is run at all."""

    kind: str
    text: str
    long: bool
    run: bool


def blocks(page: str) -> list[Block]:
    """The fenced blocks of a page, in order. A quoted output is as long as what printed it."""
    found: list[Block] = []
    for fence in FENCE.finditer(page):
        if fence[1] == REFERENCE:
            continue
        before = page[: fence.start()].rstrip().rpartition("\n\n")[2]
        kind, text = fence.groups()
        long = before.endswith(LONG) or (kind == "text" and found[-1].long)
        found.append(Block(kind, text, long, not before.startswith(NOT_RUN)))
    return found


def house(folder: Path) -> dict[str, str]:
    """The project in `folder`, whose workflow may be edited, and the environment to run it."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "workflow", folder / "workflow", ignore=ignored)
    for name in ("Snakefile", "config.yaml"):
        shutil.copy(ROOT / name, folder)
    for name in ("docs", "envs", "profiles"):
        (folder / name).symlink_to(ROOT / name)
    for name in ("demo_capture", "rigsim"):  # on an address that nobody else uses
        file = folder / "workflow" / "config" / f"{name}.yaml"
        text = file.read_text(encoding="utf-8")
        file.write_text(text.replace("host: 127.0.0.2", f"host: {HOST}"), encoding="utf-8")
    commands = folder / "bin"
    commands.mkdir()
    modules = {"eitskin": "-m eitskin.cli", "snakemake": "-m snakemake", "python": ""}
    for name, module in modules.items():
        (commands / name).write_text(f'#!/bin/sh\nexec {sys.executable} {module} "$@"\n')
        (commands / name).chmod(0o755)
    return os.environ | {
        "PATH": f"{commands}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(folder / "workflow"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def quoted(text: str) -> re.Pattern:
    """What prints as a quotation does."""
    return re.compile(".*".join(map(re.escape, text.strip().split("…"))), re.DOTALL)


def printed(command: str, folder: Path, environment: dict[str, str]) -> str:
    """What commands of the shell print, messages among it; they may end in exit codes 1 and 2."""
    ran = subprocess.run(
        ["sh", "-c", command],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=LIMIT_S,
    )
    assert ran.returncode in (0, 1, 2), ran.stdout
    assert "Traceback" not in ran.stdout, ran.stdout
    said = ran.stdout.replace("\u00a0", " ")  # between a number and its unit
    return "\n".join(line.rstrip() for line in said.strip().splitlines())


def run(page: str, folder: Path, long: bool) -> None:
    """The blocks of a page, in order, in a copy of the project."""
    environment, said = house(folder), ""
    for block in blocks(page):
        if not block.run or (block.long and not long):
            continue
        if block.kind == "sh":
            said = printed(block.text, folder, environment)
        elif block.kind == "text":
            assert quoted(block.text).fullmatch(said), f"{block.text}\nis quoted, printed:\n{said}"
        elif block.kind == "diff":
            change = ["patch", "-p1", "--fuzz=0", "--no-backup-if-mismatch"]
            subprocess.run(change, cwd=folder, input=block.text, text=True, check=True)
        else:
            name = re.match(r"# (\S+)\n", block.text)[1]
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(block.text, encoding="utf-8")


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_the_short_steps_run(path, tmp_path):
    run(text_of(path), tmp_path, long=False)


@pytest.mark.long
@pytest.mark.parametrize(
    "path", [path for path in PAGES if LONG in text_of(path)], ids=lambda path: path.stem
)
def test_all_steps_run(path, tmp_path):
    run(text_of(path), tmp_path, long=True)


def test_nothing_else_is_left_out():
    found = {p.stem: [b.text.strip() for b in blocks(text_of(p)) if not b.run] for p in PAGES}
    assert {page: commands for page, commands in found.items() if commands} == LEFT_OUT


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_every_block_is_of_a_known_kind_and_no_output_stands_alone(path):
    found = blocks(text_of(path))
    references = text_of(path).count(f"```{REFERENCE}")
    assert text_of(path).count("```") == 2 * (len(found) + references)
    for before, block in zip([None, *found], found, strict=False):
        assert block.kind in KINDS, block.text
        if block.kind == "text" and block.run:
            assert before is not None and before.kind == "sh" and before.run, block.text
        if block.kind in ("python", "yaml") and block.run:
            assert re.match(r"# [\w./-]+\n", block.text), block.text


@pytest.mark.parametrize(
    ("said", "fits"),
    [("one\nthree", False), ("one\ntwo", True), ("o…\ntwo", True), ("one", False), ("…two", True)],
)
def test_a_quotation_that_is_not_printed_fails(said, fits, tmp_path):
    page = f"```sh\nprintf 'one\\ntwo\\n'\n```\n\nprints\n\n```text\n{said}\n```\n"
    if fits:
        run(page, tmp_path, long=False)
    else:
        with pytest.raises(AssertionError, match="is quoted, printed"):
            run(page, tmp_path, long=False)


def test_a_command_that_ends_in_a_traceback_fails(tmp_path):
    with pytest.raises(AssertionError, match="Traceback"):
        run('```sh\npython -c "1 / 0"\n```\n', tmp_path, long=False)


def test_what_is_long_or_not_run_is_left_out(tmp_path):
    page = (
        f"{LONG}\n\n```sh\ntouch long\n```\n\n```text\nnothing of it\n```\n\n"
        f"{NOT_RUN}it needs a board.\n\n```sh\ntouch never\n```\n\n"
        "Run:\n\n```sh\ntouch short\n```\n"
    )
    run(page, tmp_path, long=False)
    there = {path.name for path in tmp_path.iterdir()}
    assert "short" in there and not there & {"long", "never"}
