"""What a file says of a skin: a statement, a recording or a drawing."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eitskin.data import reading, stated
from eitskin.drawing import svg
from eitskin.drawing.rim import skin_block
from eitskin.errors import InputError
from eitskin.physics.outline import DISCS, laid_out, refuse
from eitskin.physics.protocol import pattern_step
from eitskin.physics.skin import Skin

DRAWINGS = (".svg", ".dxf")
STATEMENTS = (".yaml", ".yml")
OTHER_DRAWINGS = (  # which nothing here reads
    *(".dwg", ".pdf", ".ai", ".eps", ".ps", ".png", ".jpg", ".jpeg", ".gif", ".bmp", ".tif"),
    *(".tiff", ".step", ".stp", ".iges", ".igs", ".stl", ".kicad_pcb", ".gbr", ".f3d", ".sldprt"),
)


@dataclass(frozen=True)
class StatedSkin:
    """block: keys of the recording format's `skin` as the file says them; drives: (D, 2), source
    and sink of each, none where they are not known; sentences: on what was made of a drawing."""

    block: dict
    skin: Skin
    drives: np.ndarray
    n_electrodes: int
    sentences: tuple[str, ...]


def kind(file: str | Path) -> str:
    """drawing, statement or recording, by the suffix. Raises InputError for a drawing of a kind
    that is not read."""
    suffix = Path(file).suffix.lower()
    if suffix in OTHER_DRAWINGS:
        expected = "an SVG or DXF drawing, a statement in YAML, or a recording"
        raise InputError(file, "suffix", suffix, expected)
    if suffix in DRAWINGS:
        return "drawing"
    return "statement" if suffix in STATEMENTS else "recording"


def drawing(
    file: str | Path, unit_mm: float | None, mirrored: bool, drive: str | None
) -> StatedSkin:
    """The skin of an SVG or DXF drawing; unit_mm and mirrored as of `rim.skin_block`, drive a
    pattern of `protocol`. Raises InputError, which names the file and the shape."""
    if Path(file).suffix.lower() == ".svg":
        curves = svg.read(file)
    else:
        from eitskin.drawing import dxf  # half a second

        curves = dxf.read(file)
    block, sentences = skin_block(curves, unit_mm, mirrored, file)
    return _stated(block, drive, sentences, file)


def statement(file: str | Path, drive: str | None) -> StatedSkin:
    """The skin of a YAML statement. Raises InputError as `stated.read`."""
    values = stated.read(file)
    return _stated({k: v for k, v in values.items() if k in stated.SKIN}, drive, [], file)


def recording(file: str | Path, skin: str | None, settings: dict[str, Any]) -> StatedSkin:
    """The skin of a recording in any known format, with the statement in the file `skin`; settings
    as of `reading.read`. Raises InputError as that does."""
    recorded = reading.read(file, skin, **settings)
    drives = np.unique(recorded.channels[:, :2], axis=0)
    block = recorded.metadata["skin"]
    count = int(recorded.channels.max()) + 1
    return StatedSkin(block, _drawable(block, file), drives, count, ())


def _stated(block: dict, drive: str | None, sentences: list[str], file: str | Path) -> StatedSkin:
    skin = _drawable(block, file)
    angles = laid_out(skin).electrode_deg
    count = 0 if angles is None else len(angles)
    drives = np.zeros((0, 2), int)
    if drive is not None and count:
        source = np.arange(count)
        drives = np.stack([source, (source + pattern_step(drive, count)) % count], axis=1)
    return StatedSkin(block, skin, drives, count, tuple(sentences))


def _drawable(block: dict, file: str | Path) -> Skin:
    """The Skin of a block. Raises InputError for one without a radius and an outline, and as
    `outline.refuse`."""
    skin = Skin.from_metadata(dict.fromkeys(stated.SKIN) | block)
    is_disc = skin.outline is None or str(skin.outline).strip().lower() in DISCS
    if skin.radius_mm is None and is_disc:
        expected = "radius_mm, or outline of a skin that is no disc"
        raise InputError(file, "radius_mm", "nothing", expected)
    refuse(skin, file)
    return skin
