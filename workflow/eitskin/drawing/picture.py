"""A skin as an SVG drawing, in mm: rim with lengths, electrodes numbered, drives as arrows."""

from html import escape

import numpy as np

from eitskin.physics.geometry import even_angles
from eitskin.physics.outline import laid_out
from eitskin.physics.rim_curve import RimCurve
from eitskin.physics.skin import Skin
from eitskin.skin_layout import SkinLayout, layout

MOST_LENGTHS = 16  # sides of a rim whose lengths are written
TEXT_SHARE = 0.04  # height of a letter, of the larger side of the box around the rim
CROWDED = 0.7  # height of a number, of the smallest distance between electrodes
STRETCH_POINTS = 25  # of a drawn electrode
SHORTER = 0.12  # of an arrow, left free at each end
STYLE = """\
text { font-family: sans-serif; fill: #222; stroke: #fff; stroke-opacity: 0.8 }
text { stroke-width: 0.25em; stroke-linejoin: round; paint-order: stroke }
.rim { fill: #f2f6fa; stroke: #222 }
.electrode { fill: none; stroke: #c0392b; stroke-linecap: butt }
.dot { fill: #c0392b }
.drive { fill: none; stroke: #2874a6 }
.axis { fill: none; stroke: #888 }
.grey { fill: #666 }
"""


def picture(skin: Skin, drives: np.ndarray, n_electrodes: int, title: str) -> str:
    """The text of an SVG file; drives: (D, 2) source and sink of each; n_electrodes: of a skin
    whose angles are not stated. The rim has the id `rim`, the electrodes are the group
    `electrodes`.

    Raises InputError for an outline that cannot be laid out, and for one that is not stated.
    """
    drawn = layout(skin, n_electrodes, 0.0)
    rim = skin.rim
    size = 2.0 * drawn.half_extent_mm
    letter = TEXT_SHARE * size
    electrodes, outward = drawn.electrodes, drawn.outward
    number = letter
    if len(electrodes) > 1:
        spacing = np.abs(np.roll(electrodes, -1) - electrodes).min()
        number = min(letter, max(CROWDED * float(spacing), 0.25 * letter))
    line = 0.1 * letter
    parts = [f'<path id="rim" class="rim" stroke-width="{line:.4g}" d="{_path(drawn.rim)} Z"/>']
    parts += _axes(letter)
    parts += _arrows(electrodes - 0.9 * letter * outward, drives, line)
    parts += _lengths(rim, letter)
    marks = _electrodes(skin, n_electrodes, drawn, 2.5 * line)
    parts += ['<g id="electrodes">', *marks, "</g>"]
    parts += [
        _text(str(k), place, number)
        for k, place in enumerate(electrodes + 0.9 * number * outward + 0.2 * letter * outward)
    ]
    x, y = drawn.rim.real, drawn.rim.imag
    margin = 3.0 * letter
    left, top = x.min() - margin, -y.max() - margin
    lines = _caption(skin, drawn.rim, rim, len(electrodes), drives, title)
    width = max(np.ptp(x) + 2.0 * margin, 0.55 * letter * max(map(len, lines)) + margin)
    height = np.ptp(y) + 2.0 * margin + 1.5 * letter * len(lines)
    for k, sentence in enumerate(lines):
        place = complex(left + 0.5 * margin, y.min() - margin - 1.5 * letter * (k + 0.3))
        parts.append(_text(sentence, place, letter, "start"))
    box = f"{left:.4f} {top:.4f} {width:.4f} {height:.4f}"
    tip = '<path d="M 0 0 L 6 2 L 0 4 z" fill="#2874a6"/>'
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" '
            f'height="{height:.4f}mm" viewBox="{box}">',
            f"<title>{escape(title)}</title>",
            f"<style>\n{STYLE}</style>",
            '<defs><marker id="tip" markerWidth="6" markerHeight="4" refX="6" refY="2" '
            f'orient="auto">{tip}</marker></defs>',
            *parts,
            "</svg>\n",
        ]
    )


def _path(points: np.ndarray) -> str:
    return "M " + " L ".join(f"{z.real:.4f} {-z.imag:.4f}" for z in points)


def _text(words: str, place: complex, letter: float, anchor: str = "middle", name: str = "") -> str:
    return (
        f'<text x="{place.real:.4f}" y="{-place.imag + 0.35 * letter:.4f}" '
        f'font-size="{letter:.4g}" text-anchor="{anchor}"{name}>{escape(words)}</text>'
    )


def _axes(letter: float) -> list[str]:
    """Lines along x and y from the origin of the places."""
    parts = []
    for word, direction in (("x", 1.0 + 0j), ("y", 1j)):
        end = 2.0 * letter * direction
        d = _path(np.array([0j, end]))
        line = f'stroke-width="{0.06 * letter:.4g}"'
        parts.append(f'<path class="axis" {line} d="{d}"/>')
        parts.append(_text(word, end + 0.5 * letter * direction, 0.7 * letter))
    return parts


def _lengths(rim: RimCurve | None, letter: float) -> list[str]:
    """The length of every side, in mm, beside its middle and within; none of a bent rim."""
    if rim is None or rim.smooth or len(rim.points) > MOST_LENGTHS:
        return []
    steps = rim.steps
    middles = rim.points + 0.5 * steps
    inward = 1j * steps / np.abs(steps)
    parts = []
    for place, side, normal in zip(middles, np.abs(steps), inward, strict=True):
        shift = letter * (1.6 + 0.8 * abs(normal.real))
        parts.append(
            _text(f"{side:.4g}", place + shift * normal, 0.8 * letter, name=' class="grey"')
        )
    return parts


def _arrows(places: np.ndarray, drives: np.ndarray, line: float) -> list[str]:
    """An arrow from every source to its sink."""
    parts = []
    for source, sink in drives:
        step = places[sink] - places[source]
        d = _path(np.array([places[source] + SHORTER * step, places[sink] - SHORTER * step]))
        parts.append(
            f'<path class="drive" stroke-width="{0.7 * line:.4g}" marker-end="url(#tip)" d="{d}"/>'
        )
    return parts


def _electrodes(skin: Skin, n_electrodes: int, drawn: SkinLayout, line: float) -> list[str]:
    """Stretches of the rim and discs inside of the stated width, else dots at their middles."""
    if not skin.electrode_width_mm:
        return [_disc(z, line) for z in drawn.electrodes]
    laid = laid_out(skin)
    deg = even_angles(n_electrodes) if laid.electrode_deg is None else laid.electrode_deg
    assert laid.radius_mm is not None
    half = 0.5 * skin.electrode_width_mm / laid.radius_mm
    parts = []
    for number, phi in enumerate(np.radians(np.asarray(deg))):
        if number in drawn.inside:
            parts.append(_disc(drawn.electrodes[number], 0.5 * skin.electrode_width_mm))
            continue
        angles = phi + np.linspace(-half, half, STRETCH_POINTS)
        rim = laid.rim
        stretch = rim.place(angles) if rim else laid.radius_mm * np.exp(1j * angles)
        parts.append(f'<path class="electrode" stroke-width="{line:.4g}" d="{_path(stretch)}"/>')
    return parts


def _disc(centre: complex, radius: float) -> str:
    return f'<circle class="dot" cx="{centre.real:.4f}" cy="{-centre.imag:.4f}" r="{radius:.4g}"/>'


def _caption(
    skin: Skin,
    drawn: np.ndarray,
    rim: RimCurve | None,
    n_electrodes: int,
    drives: np.ndarray,
    title: str,
) -> list[str]:
    """Lines below the drawing."""
    if rim is None:
        radius = float(np.abs(drawn[0]))
        shape = f"disc, diameter {2.0 * radius:.4g} mm, rim {2.0 * np.pi * radius:.4g} mm long"
    else:
        width, height = np.ptp(drawn.real), np.ptp(drawn.imag)
        shape = f"{width:.4g} x {height:.4g} mm, rim {rim.perimeter_mm:.4g} mm long"
    electrodes = f"{n_electrodes} electrodes"
    if skin.electrode_width_mm:
        electrodes += f", {skin.electrode_width_mm:g} mm wide"
    if len(drives):
        electrodes += f"; {len(drives)} drives, source to sink"
    return [title, shape, electrodes, "seen from the touched side"]
