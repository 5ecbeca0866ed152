"""The report of a diagnosis: one HTML file for a person, with the figures inside and beside it."""

from html import escape
from pathlib import Path

from eitskin import cores, plotting
from eitskin.atomic import atomic_path
from eitskin.diagnose.report import figures, sections
from eitskin.diagnose.report.answer import answer, names, warnings
from eitskin.diagnose.report.evidence import Evidence, read
from eitskin.diagnose.report.glossary import glossary, with_terms
from eitskin.diagnose.report.markup import document, figure, figure_row

CAPTIONS = {
    "electrodes": "The ring of electrodes, numbered from 0. Numbers in discs mark what is named"
    " above, at its electrodes or place; arrows are drives, dotted lines measuring pairs.",
    "hidden": "Error of the simulation {channels}: the darker the larger. {of}{after} White:"
    " {white}.",
    "residual_matrix": "Every channel: what the simulation leaves, in one colour scale, or in one"
    f" each where they differ by more than {figures.LARGEST_SCALE_RATIO} times. A dash: well below"
    " the simulation. Grey: channels that are not read. An electrode's fault shows as its two rows"
    " and columns, a gain as one row or column.",
    "misfit_force": "Misfit against force. Dots are frames, lines their means: before with squares,"
    " after with circles.",
    "misfit_time": "Misfit against time. Dots are frames, lines their means: before with squares,"
    " after with circles.",
    "misfit_place": "Misfit over the skin.",
    "last": "The misfit of what decided nothing: before a square, after a circle.",
    "rivals": "Each name taken out again, and others in its place: what was not put aside is held"
    " out in turn and predicted from the rest, against the noise and rig errors of all that is"
    " named. In brackets: the difference in log predictive density; below 0 is worse.",
    "next_experiment": "What the next experiment would tell apart. Shaded: a gap under 3, where"
    " names are one class.",
}


def write(
    folder: str | Path,
    recording_path: str | Path,
    schema: str | Path,
    report_path: str | Path,
    prediction_path: str | Path | None = None,
) -> None:
    """Write the report of the diagnosis in a folder to `report_path`, and figures/*.svg and *.png
    beside it.

    prediction_path: predicted.parquet, where the diagnosis was given a query. Equal inputs give
    equal bytes. Raises InputError as `evidence.read` does.
    """
    evidence = read(folder, recording_path, schema, prediction_path)
    drawings = figures.draw(evidence)
    files = cores.forked(
        lambda drawing: (plotting.svg(drawing), plotting.png(drawing)), drawings.values()
    )
    figure_html = {}
    for (name, drawing), (svg, png) in zip(drawings.items(), files, strict=True):
        figure_html[name] = f"<p>{escape(drawing)}</p>" if isinstance(drawing, str) else svg
        svg_path, png_path = _figure_paths(report_path, name)
        with atomic_path(svg_path) as path:
            path.write_text(svg, encoding="utf-8")
        with atomic_path(png_path) as path:
            path.write_bytes(png)
    change_drawings = [
        plotting.svg(drawing) if drawing else "" for drawing in figures.draw_changes(evidence)
    ]
    with atomic_path(report_path) as path:
        path.write_text(page(evidence, figure_html, change_drawings), encoding="utf-8")


def figure_paths(report_path: str | Path) -> list[Path]:
    """The files of figures that `write` writes beside a report."""
    return [path for name in figures.FIGURES for path in _figure_paths(report_path, name)]


def _figure_paths(report_path: str | Path, name: str) -> tuple[Path, Path]:
    """A figure as SVG and as PNG."""
    path = Path(report_path).parent / "figures" / name
    return path.with_suffix(".svg"), path.with_suffix(".png")


def page(evidence: Evidence, drawings: dict[str, str], change_drawings: list[str]) -> str:
    """The report as HTML.

    drawings: by name, each figure as SVG, or a paragraph that says why there is none;
    change_drawings: what each effect changes, as SVG, "" where it has no picture.
    """
    name = escape(evidence.diagnosis["recording"])
    captions = CAPTIONS | {
        "hidden": CAPTIONS["hidden"].format(**sections.hidden_caption(evidence)),
        "misfit_place": CAPTIONS["misfit_place"] + figures.unmapped_text(evidence),
    }
    shown = {key: figure(key, drawings[key], captions[key]) for key in figures.FIGURES}
    proof = [
        names(evidence, change_drawings),
        "<h2>Where</h2>",
        figure_row(shown["electrodes"], shown["residual_matrix"]),
        "<h2>Where the misfit is, and where it went</h2>",
        sections.misfit_legend(evidence),
        figure_row(shown["misfit_force"], shown["misfit_time"], shown["misfit_place"]),
        sections.last(evidence),
        figure_row(shown["last"], shown["rivals"]),
        sections.rig(evidence),
        sections.unnamed(evidence),
        sections.next_experiment(evidence, shown["next_experiment"]),
        sections.unobservable(evidence),
        sections.why_not(evidence),
        sections.identifiability(evidence),
        sections.atlas(evidence),
        sections.calibration(evidence),
        sections.noise(evidence),
        sections.record(evidence),
    ]
    elements = [
        f"<p class='quiet'>Diagnosis of {name}</p>",
        answer(evidence, shown["hidden"]),
        warnings(evidence),
        sections.parts(evidence),
        "<details id='proof'><summary>How we know</summary>",
        *filter(None, proof),
        "</details>",
    ]
    body = with_terms("\n".join(filter(None, elements)))
    return document(f"Diagnosis of {name}", f"{body}\n{glossary()}")
