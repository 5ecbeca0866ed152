"""The words of a report and of the documentation that a reader may not know: one meaning each."""

import re
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True)
class Term:
    """A word: as the glossary lists it, the pattern of its mentions, and what it means."""

    name: str
    mention: str
    meaning: str

    @property
    def anchor(self) -> str:
        """Its place in the glossary."""
        return "term-" + re.sub(r"\W+", "-", self.name.lower()).strip("-")


TERMS = (
    Term(
        "90 % interval",
        r"90 %",
        "The range that holds the true value in nine of ten cases, if the name is right.",
    ),
    Term(
        "atlas",
        r"\b[Aa]tlas\b",
        "A list of patterns by which simulation and recording may differ, each tested apart.",
    ),
    Term(
        "candidate",
        r"\bcandidates?\b",
        "A cause that fits but failed a check of certainty: to be tried at the bench.",
    ),
    Term(
        "certain",
        r"\bcertain\b",
        "A cause that passed every check: it predicts hidden readings, no other cause does as well,"
        " and its size is not nothing.",
    ),
    Term(
        "channel",
        r"\b[Cc]hannels?\b",
        "One reading of a frame: a pair of electrodes that drive and a pair that measure.",
    ),
    Term(
        "degree of freedom",
        r"\bdegrees? of freedom\b",
        "A reading, less what was fitted to it: what a sum of squares is divided by.",
    ),
    Term(
        "drive",
        r"\b[Dd]rives?\b",
        "The pair of electrodes that the current goes in and out by; named after the first.",
    ),
    Term(
        "false discovery rate",
        r"\bfalse discovery rate\b",
        "Among all patterns that are called found, the share that chance alone makes.",
    ),
    Term(
        "family",
        r"\b[Ff]amil(?:y|ies)\b",
        "What is a little wrong at every electrode or pair: one size for all, no culprit.",
    ),
    Term(
        "frame",
        r"\b[Ff]rames?\b",
        "One reading of every channel, at one time.",
    ),
    Term(
        "gap",
        r"\bgaps?\b",
        "How different the readings of two causes are, in noise units: below 3 this recording"
        " cannot tell them apart.",
    ),
    Term(
        "hidden readings",
        r"\bhidden readings\b|\bdecided nothing\b|\bput aside\b",
        "Readings that the diagnosis did not look at before all was decided: they test its answer.",
    ),
    Term(
        "held out in turn",
        r"\bheld out\b|\bheld-out\b",
        "A part of the readings that is predicted from the others; then the next part.",
    ),
    Term(
        "log evidence",
        r"\blog evidence\b",
        "How probable the readings are by a set of causes, all sizes of these considered, in nats.",
    ),
    Term(
        "measuring pair",
        r"\bmeasuring pairs?\b",
        "The pair of electrodes whose voltage is read; named after the first.",
    ),
    Term(
        "misfit",
        r"\b[Mm]isfits?\b",
        "By how much recording and simulation differ; 1 where nothing but noise differs.",
    ),
    Term(
        "nat",
        r"\bnats?\b",
        "A unit of evidence: 1 nat more and the readings are 2.7 times as probable; 10, 22000"
        " times.",
    ),
    Term(
        "noise unit",
        r"\b(?:noise units?|units? of the noise)\b",
        "The standard deviation of a reading's noise: 3 units are hardly chance.",
    ),
    Term(
        "p",
        r"\bp(?= =|:)|\bp-values?\b",
        "How often chance alone gives as much: 0.01 is once in a hundred recordings.",
    ),
    Term(
        "reciprocity",
        r"\b[Rr]eciproc\w+\b",
        "Drive and measurement exchanged read the same voltage: what differs is no skin.",
    ),
    Term(
        "residual",
        r"\b[Rr]esiduals?\b",
        "Recording minus simulation.",
    ),
    Term(
        "rms",
        r"\brms\b",
        "Root mean square: the typical size, large values counting more.",
    ),
    Term(
        "signature",
        r"\bsignatures?\b",
        "What a cause changes in all readings: its fingerprint.",
    ),
    Term(
        "χ²",
        "χ²",
        "The sum of squared errors in noise units; 1 a degree of freedom is noise alone.",
    ),
)


def with_terms(body: str) -> str:
    """HTML with the first mention of each term in its text linked to the glossary, with its meaning
    on hover and, on paper, in brackets. Names of files, pictures, headings and links stay."""
    parts = re.split(r"(<[^>]+>)", body)
    missing = {term: re.compile(term.mention) for term in TERMS}
    closed = {"svg", "code", "pre", "a", "h1", "h2", "h3", "summary", "td", "th"}
    inside: list[str] = []
    for place, part in enumerate(parts):
        if part.startswith("<"):
            tag = re.match(r"</?(\w+)", part)
            name = tag[1] if tag else ""
            if name in closed and part.startswith("</"):
                inside.pop()
            elif name in closed and not part.endswith("/>"):
                inside.append(name)
            continue
        if inside or not part.strip():
            continue
        marks: list[tuple[int, int, Term]] = []
        for term, pattern in list(missing.items()):
            found = pattern.search(part)
            if found and not any(
                found.start() < end and start < found.end() for start, end, _ in marks
            ):
                marks.append((found.start(), found.end(), term))
                del missing[term]
        for start, end, term in sorted(marks, key=lambda mark: -mark[0]):
            meaning = escape(term.meaning, quote=True)
            link = f"<a class='term' href='#{term.anchor}' title='{meaning}'>"
            part = f"{part[:start]}{link}{part[start:end]}</a>{part[end:]}"
        parts[place] = part
    return "".join(parts)


def glossary() -> str:
    """The glossary as HTML."""
    items = [
        f"<dt id='{term.anchor}'>{term.name}</dt><dd>{escape(term.meaning)}</dd>"
        for term in sorted(TERMS, key=lambda term: term.name.lower())
    ]
    return f"<details><summary>Glossary</summary>\n<dl>{''.join(items)}</dl>\n</details>"
