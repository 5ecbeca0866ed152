"""Numbers on the pages: a measured one stands in a passage that its rows make, or in a table that a
command wrote, a line a recording; every other one is in `stated.yaml`, as it was not measured."""

import re
from pathlib import Path

import pytest
import yaml

from manual.__main__ import PAGES as FROM_THE_CODE
from manual.passages import PASSAGE, filled

ROOT = Path(__file__).parents[3]
PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "config.yaml")),
    *(path for path in sorted((ROOT / "docs").rglob("*.md")) if path.name not in FROM_THE_CODE),
]
ROWS = {  # pages with tables that a command wrote: a line a recording, a case or a claim
    f"docs/{name}.md"
    for name in ("concealed/final", "concealed/gate", "concealed/objects", "loop/loop", "tanks")
} | {"docs/paper/table_2.md"}
STATED = yaml.safe_load((Path(__file__).parent / "stated.yaml").read_text(encoding="utf-8"))
NUMBER = r"[0-9][0-9.,·⁻⁰¹²³⁴⁵⁶⁷⁸⁹]*"
TIME = r"processor|ms\b|s\b|seconds?\b|min(?:utes?)?\b|hours?\b|h\b"
WORD = r"(?i:two|three|four|five|six|seven|eight|nine|ten|eleven|twelve|twenty|thirty|hundred)"
UNIT = rf"%|per ?cent\b|\N{{MULTIPLICATION SIGN}}|times\b|{TIME}|[KMG]i?B\b|nats\b"
MEASURED = re.compile(
    rf"(?<![\w.]){NUMBER}(?:(?: to |\N{{EN DASH}}|-){NUMBER})? (?:{UNIT})"  # a share, a time
    rf"|(?<![\w.]){NUMBER}%"
    rf"|(?<![\w.]){NUMBER} (?:out of|of|in|among) (?:the |its |these )?{NUMBER}"  # a count
    rf"|(?<![\w./-]){NUMBER}/[0-9]+(?![\w/.-])"
    rf"|\b(?i:{WORD}|half|third|quarter|tenth) (?:out of|of|in) (?:the |its |these )?{WORD}\b"
    rf"|\b{WORD} per ?cent\b"
    rf"|\b[pr] ?[=<>≈] ?{NUMBER}"  # a chance, a correlation
    rf"|± {NUMBER}"
    r"|(?<![\w.])[0-9]+\.[0-9]+ (?:mm|N|mV|µV|V)\b"  # a length, a force, a voltage not whole
    r"|\| \**[\N{MINUS SIGN}+-]?[0-9]+\.[0-9]+[^|]*(?= \|)"  # a table's cell that begins so
)
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)


def _name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def unfounded(name: str, text: str) -> list[str]:
    """The numbers of a page that look measured, with what stands around them, of which nothing says
    where they are from."""
    text = CODE.sub(" ` ", PASSAGE.sub("", text))
    if name in ROWS:
        text = "\n".join(line for line in text.splitlines() if not line.startswith("|"))
    text = " ".join(text.split())
    for phrase in STATED.get(name, []):
        text = text.replace(phrase, " ")
    return [text[max(m.start() - 40, 0) : m.end() + 30] for m in MEASURED.finditer(text)]


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_no_measured_number_is_without_rows(page):
    assert unfounded(_name(page), page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_passages_are_what_their_rows_make(page):
    text = page.read_text(encoding="utf-8")
    assert (
        text.count("<!-- rows:") == text.count("<!-- end of rows -->") == len(PASSAGE.findall(text))
    )
    assert filled(text) == text


@pytest.mark.parametrize("name", STATED)
def test_what_is_stated_stands_on_its_page(name):
    text = " ".join(CODE.sub(" ` ", (ROOT / name).read_text(encoding="utf-8")).split())
    for phrase in STATED[name]:
        assert MEASURED.search(phrase) and phrase in text, phrase


@pytest.mark.parametrize(
    "sentence",
    (
        "It is right in 83 of 89.",
        "It takes 10.8 s, 2.3 GiB at most.",
        "| named | 93.3 % |",
        "Places are 1.6 times as far off.",
        "It is right in 83 out of 89, or 83/89.",
        "Nine of ten were named.",
        "Three out of four, 75 percent, are right.",
        "It takes 2\N{EN DASH}3 seconds.",
        "It is as good as chance (p = 0.03).",
        "An error of 1.20 ± 0.01.",
    ),
)
def test_a_number_without_rows_is_noticed(sentence):
    assert unfounded("README.md", sentence)
    assert not unfounded("README.md", f"<!-- rows: often -->\n{sentence}\n<!-- end of rows -->")
