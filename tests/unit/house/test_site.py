"""The site: its sidebar in groups, no page without a way to it, none under another's title."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[3] / "docs"
INDEX = DOCS / "index.md"
GROUPS = ["Start", "Use", "Understand", "Results", "Python", "Contribute"]
MOST_ENTRIES = 14  # of a group: more are not looked over at a glance
PAGES = sorted(DOCS.rglob("*.md"))
TREE = re.compile(r"```\{toctree\}\n(.*?)```", re.DOTALL)
LINK = re.compile(r"\]\(([^)#\s]+\.md)(#[^)]*)?\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)


def text_of(page: Path) -> str:
    """A page with what it includes."""
    text = page.read_text(encoding="utf-8")
    included = re.match(r"```\{include\} (\S+)", text)
    return (page.parent / included[1]).read_text(encoding="utf-8") if included else text


def title(page: Path) -> str:
    return re.search(r"^# (.+)$", text_of(page), re.MULTILINE)[1]


def sidebar() -> dict[str, list[Path]]:
    """The pages of each group."""
    groups = {}
    for tree in TREE.findall(INDEX.read_text(encoding="utf-8")):
        entries = [line for line in tree.splitlines() if line and not line.startswith(":")]
        caption = re.search(r":caption: (.+)", tree)
        groups[caption[1]] = [DOCS / f"{entry}.md" for entry in entries]
    return groups


def linked(page: Path) -> list[Path]:
    """The pages of the site that a page links to."""
    base = DOCS.parent if page.name == "contributing.md" else page.parent
    targets = [(base / target).resolve() for target, _ in LINK.findall(text_of(page))]
    return [target for target in targets if target.is_relative_to(DOCS)]


def test_the_sidebar_has_six_groups_of_pages_that_exist():
    groups = sidebar()
    assert list(groups) == GROUPS
    pages = [page for group in groups.values() for page in group]
    assert len(set(pages)) == len(pages) and all(page.is_file() for page in pages)
    assert all(0 < len(group) <= MOST_ENTRIES for group in groups.values())


def test_every_page_is_reached_from_the_index():
    reached, waiting = set(), [INDEX]
    while waiting:
        page = waiting.pop()
        if page not in reached and page.is_file():
            reached.add(page)
            waiting += linked(page)
    assert [page for page in PAGES if page not in reached] == []


def test_what_is_not_in_the_sidebar_says_so():
    shown = {page for group in sidebar().values() for page in group} | {INDEX}
    for page in PAGES:
        hidden = text_of(page).startswith("---\norphan: true\n---\n")
        assert hidden != (page in shown), page


def test_no_two_pages_have_one_title():
    titles = [title(page).lower() for page in PAGES]
    assert len(set(titles)) == len(titles)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_links_lead_to_headings(page):
    base = DOCS.parent if page.name == "contributing.md" else page.parent
    for target, anchor in LINK.findall(text_of(page)):
        other = base / target
        assert other.is_file(), target
        if anchor:
            slugs = [
                re.sub(r"[^\w\- ]", "", each.lower()).replace(" ", "-")
                for each in HEADING.findall(text_of(other))
            ]
            assert anchor[1:] in slugs, f"{target}{anchor}"


@pytest.mark.parametrize("word", ["rectangular", "glossary"])
def test_a_word_that_is_looked_for_is_found(word):
    assert any(re.search(rf"\b{word}\b", text_of(page), re.IGNORECASE) for page in PAGES)
