"""The glossary of a report: a meaning for each word, at its first mention and no other."""

import re

import pytest

from eitskin.diagnose.report.glossary import TERMS, glossary, with_terms

SKIPPED = ("code", "h1", "h2", "h3", "td", "th", "summary", "svg", "a")


def test_a_word_is_linked_at_its_first_mention_with_its_meaning():
    body = with_terms("<p>The misfit, then the misfit again, in noise units: 3 nats.</p>")
    assert re.findall(r">(\w[\w ]*)</a>", body) == ["misfit", "noise units", "nats"]
    assert "then the misfit again" in body
    for anchor, meaning in re.findall(r"href='#([\w-]*)' title='([^']*)'", body):
        assert meaning and f"id='{anchor}'" in glossary()


@pytest.mark.parametrize("tag", SKIPPED)
def test_names_headings_and_cells_stay(tag):
    text = f"<{tag}>misfit</{tag}><p>nothing here</p>"
    assert with_terms(text) == text
    assert "</a>" in with_terms(f"{text}<p>misfit</p>")


@pytest.mark.parametrize("term", TERMS, ids=lambda term: term.name)
def test_every_word_is_mentioned_by_its_name_and_meant_in_a_sentence(term):
    assert re.search(term.mention, f"{term.name} = " if term.name == "p" else term.name)
    assert term.meaning.endswith(".") and term.meaning[0].isupper()


def test_no_two_words_share_a_place():
    assert len({term.anchor for term in TERMS}) == len(TERMS)
    assert all(re.fullmatch(r"term-[\wχ²-]+", term.anchor) for term in TERMS)
