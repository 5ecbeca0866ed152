"""The HTML of pages: their style, and figures and tables as elements."""

import re
from collections.abc import Iterable
from html import escape

CSS = """
:root { color-scheme: light; background: #fff; }
body { font: 15px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; margin: 0 auto;
  padding: 1em 1.5em; max-width: 80em; }
h1 { font-size: 1.5em; line-height: 1.25; margin: 0.2em 0; }
h2 { font-size: 1.15em; margin: 2em 0 0.4em; border-bottom: 1px solid #ccc; }
main { display: grid; grid-template-columns: minmax(0, 1fr); gap: 0 2em; }
main h2 { margin: 0.8em 0 0.2em; border: 0; font-size: 1.05em; }
main ul { margin: 0.2em 0; padding-left: 1.2em; }
main .effect { margin: 0.4em 0; }
main .effect > div > p:first-of-type { font-size: 1em; }
main figure { margin: 0.4em 0; max-width: 34em; }
@media (min-width: 60em) { main { grid-template-columns: minmax(0, 1fr) minmax(0, 30em);
    grid-template-rows: auto 1fr; }
  main > .changed { grid-column: 2; grid-row: 1 / span 2; }
  main > div { grid-column: 1; } }
details { margin: 1em 0; } details > summary { cursor: pointer; font-weight: 600; }
details#proof > summary { font-size: 1.15em; }
a.term { color: inherit; text-decoration: underline dotted; }
dt { font-weight: 600; margin-top: 0.5em; } dd { margin: 0 0 0 1.2em; max-width: 46em; }
h3 { font-size: 1em; margin: 1.2em 0 0.3em; }
p { margin: 0.4em 0; max-width: 46em; }
.quiet, .caption, figcaption { color: #595959; }
.effect { border-left: 4px solid #8b1a6b; padding: 0.1em 0 0.1em 0.9em; margin: 1em 0;
  display: flex; flex-wrap: wrap; gap: 1.2em; align-items: flex-start; }
.effect > div { flex: 1 1 24em; }
.effect > div > p:first-of-type { font-size: 1.1em; font-weight: 600; }
.effect > figure { flex: 0 1 15em; margin: 0.3em 0; }
.warning { border: 1px solid #b84f00; padding: 0.2em 0.9em; margin: 0.6em 0; max-width: 46em; }
.candidate { border-left-style: dashed; }
.before { color: #b84f00; font-weight: 600; } .after { color: #0072b2; font-weight: 600; }
.row { display: flex; flex-wrap: wrap; gap: 1.2em; align-items: flex-start; }
figure { margin: 0.8em 0; flex: 1 1 22em; max-width: 29em; break-inside: avoid; }
figure svg { width: 100%; height: auto; display: block; }
figcaption, .caption { font-size: 0.87em; margin-top: 0.4em; }
.caption { margin: 0.6em 0 0; max-width: 53em; }
.wide { overflow-x: auto; margin: 0.2em 0 0.6em; }
table { border-collapse: collapse; font-size: 0.87em; width: 100%; }
th, td { text-align: left; padding: 0.2em 0.7em 0.2em 0; border-bottom: 1px solid #e4e4e4;
  vertical-align: top; }
th { border-bottom: 1px solid #888; }
td.n, th.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
code { font-size: 0.93em; overflow-wrap: anywhere; } .kept { white-space: nowrap; }
@media screen { td code { white-space: nowrap; }
  td:nth-child(n + 4):last-child:not(.n) { min-width: 18em; } }
@media print { a.term::after { content: " (" attr(title) ")"; font-size: 0.87em; }
  body { font-size: 10pt; padding: 0; max-width: none; } .wide { overflow: visible; }
  tr, .row, .effect { break-inside: avoid; } h2, h3, thead { break-after: avoid; } }
"""


def document(title: str, body: str) -> str:
    """A whole page of HTML, without scripts and without anything that it would have to fetch;
    title, body: HTML."""
    return (
        "<!DOCTYPE html>\n<html lang='en'>\n<head>\n<meta charset='utf-8'>\n"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>\n"
        f"<title>{title}</title>\n<style>{CSS}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


def inline_svg(svg: str, id_prefix: str, caption: str) -> str:
    """An SVG file's picture as an element of HTML, without prologue and namespaces.

    id_prefix: stands before its ids, so that they differ from those of other figures; caption: read
    aloud for it.
    """
    picture = svg[svg.index("<svg ") :]
    picture = re.sub(r"<metadata>.*?</metadata>", "", picture, flags=re.DOTALL)
    picture = re.sub(r' xmlns(:xlink)?="[^"]*"', "", picture).replace("xlink:href=", "href=")
    picture = re.sub(r'\bid="', f'id="{id_prefix}-', picture)
    picture = re.sub(r'href="#', f'href="#{id_prefix}-', picture)
    picture = picture.replace("url(#", f"url(#{id_prefix}-")
    label = escape(caption, quote=True)
    return picture.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)


def figure(id_prefix: str, drawing: str, caption: str) -> str:
    """A figure with its caption; drawing: an SVG file's text, or a paragraph in its stead, which is
    returned as it is."""
    if not drawing.startswith("<?xml"):
        return drawing
    figcaption = f"<figcaption>{escape(caption)}</figcaption>"
    return f"<figure>{inline_svg(drawing, id_prefix, caption)}{figcaption}</figure>"


def figure_row(*elements: str) -> str:
    """Figures side by side, then the paragraphs that stand for others."""
    pictures = [element for element in elements if element.startswith("<figure")]
    row = f"<div class='row'>{''.join(pictures)}</div>" if pictures else ""
    return row + "".join(element for element in elements if element not in pictures)


def table(
    heads: list[str],
    rows: Iterable[list[str]],
    number_heads: Iterable[str] = (),
    caption: str = "",
) -> str:
    """A table of cells that are HTML; columns under `number_heads` are aligned to the right."""
    classes = [" class='n'" if head in number_heads else "" for head in heads]
    head_cells = "".join(f"<th{c}>{head}</th>" for c, head in zip(classes, heads, strict=True))
    lines = [
        "<tr>"
        + "".join(f"<td{c}>{cell}</td>" for c, cell in zip(classes, row, strict=True))
        + "</tr>"
        for row in rows
    ]
    paragraph = f"<p class='caption'>{caption}</p>" if caption else ""
    head = f"{paragraph}<div class='wide'><table><thead><tr>{head_cells}</tr></thead>"
    return f"{head}<tbody>\n{chr(10).join(lines)}\n</tbody></table></div>"


def code(text: str) -> str:
    """A name as HTML, in the type of code."""
    return f"<code>{escape(text)}</code>"


def numbers_unbroken(text: str) -> str:
    """A text as HTML whose numbers stay on one line with their signs and units."""
    pattern = r"(?<!\S)(?:\(90 %:|± \S+ \S+|p = \S+)"
    return re.sub(pattern, r"<span class='kept'>\g<0></span>", escape(text))
