"""The page of a comparison: what changed between two recordings, in sentences."""

from html import escape
from pathlib import Path

from eitskin.atomic import atomic_path
from eitskin.diagnose.report.markup import document
from eitskin.quantities import listed, number


def page(comparison: dict) -> str:
    """A comparison (comparison.json) as HTML: no scripts, and nothing that it would fetch."""
    difference = comparison["difference"]
    findings = [finding["sentence"] for finding in difference["found"]]
    remarks = [text for text in comparison["sentences"] if text not in findings]
    if findings or difference["lost_channels"]:
        headline = "Between the readings something changed."
        paragraphs = [
            f"<div class='effect'><p>{escape(text)}</p></div>" for text in [*findings, *remarks]
        ]
    else:
        headline = remarks[0]
        paragraphs = [f"<p>{escape(text)}</p>" for text in remarks[1:]]
    title = escape(listed(comparison["parts"]))
    frames = " and ".join(str(count) for count in difference["untouched_frames"])
    lines = [
        f"<p class='quiet'>{title}: one skin compared</p>",
        f"<h1>{escape(headline)}</h1>",
        *paragraphs,
        f"<p class='quiet'>Found from {frames} untouched frames, but for objects without a model of"
        " the skin. A name needs"
        f" {number(difference['threshold_nats'])} nats of evidence and"
        f" {number(difference['margin_nats'])} more than any other site: with 1 nat more the"
        " readings are e = 2.7 times more probable, with 10 nats 22000 times.</p>",
    ]
    body = "\n".join(lines)
    return document(title, body)


def write(comparison: dict, path: str | Path) -> None:
    """Write the page of a comparison, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(page(comparison), "utf-8")
