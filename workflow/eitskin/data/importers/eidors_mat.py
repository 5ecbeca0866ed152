"""MATLAB files of EIDORS: readings x frames, real or complex, under any name or within structures.

EIDORS (eidors3d, `mk_stim_patterns`, `eidors_readdata`, `fwd_solve`) holds frames as columns: 208
rows of 16 electrodes, adjacent drive and measurement, drive by drive in ascending order
(`no_rotate_meas`), or 256 with the readings at driven electrodes, which `meas_select` takes out; a
data object has them in its field `meas`. A homogeneous disc reads positive there: u[j+1] - u[j]
with current entering at k. Other numbers of electrodes and other pairs: `drive`, `measure`.

Of several such arrays the one whose name says that it is the reference (`vh`, `v_homg`, `ref...`)
is read; the others, objects at places that nobody wrote down, are neither touches at known places
nor untouched frames and are left out. Frames are nobody's touches: they are taken for untouched.

A forward model in the file (`nodes`, `electrode(k).nodes`) says what the outline is, and whether
electrodes lie off the rim; its unit is nobody's, so that no size is taken from it.
"""

import re
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from eitskin.data.importers import bare_vectors
from eitskin.data.importers.bare_vectors import REVERSED, Layout
from eitskin.data.importers.matlab_file import arrays, is_matlab, shapes
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics.outline import described, off_rim, ring

LEFT_OPEN = ("order", "drive", "measure")
DRIVE, MEASURE = "adjacent", f"adjacent{REVERSED}"
REFERENCE = re.compile(
    r"v?h\d*|v?ref.*|v?ho?mg.*|v?homog.*|empty.*|untouched.*|base.*|background.*"
)
NO_READINGS = ("nodes", "elems", "boundary", "elem_data", "node_data")  # of EIDORS's models
SOURCE = "EIDORS's MATLAB file {name}, array {array} ({said})"


def matches(path: Path) -> bool:
    """Whether it is a MATLAB file; which arrays it holds `load` finds out."""
    return is_matlab(path)


def load(
    path: Path, order: str | None = None, drive: str | None = None, measure: str | None = None
) -> Recording:
    """A frame a column; raises InputError where no array, or not one alone, can be the readings."""
    drive, measure = drive or DRIVE, measure or MEASURE
    found = arrays(path)
    fitting = {}
    for name, array in found.items():
        laid = _laid_out(path, name, array, order, drive, measure)
        if laid is not None:
            fitting[name] = laid
    if not fitting:
        expected = (
            f"one array of n (n - 3) or n n rows (208 or 256 of 16 electrodes), a frame a column, "
            f"for drive {drive!r}, measure {measure!r}; --drive and --measure name other pairs"
        )
        raise InputError(path, "arrays", shapes(found), expected)
    name = _reference(path, fitting, found)
    frames, layout = fitting.pop(name)
    if order is None:
        bare_vectors.refuse_other_order(path, frames, drive, measure, layout)
    others = f"{', '.join(fitting)} left out, objects at unknown places" if fitting else ""
    said = bare_vectors.said(bare_vectors.UNTOUCHED, layout.left_out, others)
    made = bare_vectors.untouched(
        frames, layout, SOURCE.format(name=path.name, array=name, said=said)
    )
    outline = _outline(found)
    if outline is not None:
        made.metadata["skin"]["outline"] = outline
    return made


def _outline(found: dict[str, np.ndarray]) -> str | None:
    """What a forward model among arrays says of a skin that is no disc with electrodes on its rim;
    None where it is one, or where there is no model. Seen along z, by the nodes' convex hull."""
    for name, nodes in found.items():
        model, _, field = name.rpartition(".")
        if field != "nodes" or ".electrode" in name or nodes.ndim != 2 or nodes.shape[1] < 2:
            continue
        places = nodes[:, :2].astype(float)
        try:
            corners = places[ConvexHull(places).vertices]
        except (QhullError, ValueError):
            continue
        outline = described(corners)
        if outline is not None:
            return f"{outline} ({name})"
        centre, radius = ring(corners)
        numbered = re.compile(re.escape(model) + r"\.electrode(\(\d+\))?\.nodes")
        own = [found[one].ravel().astype(int) - 1 for one in found if numbered.fullmatch(one)]
        if own and all(len(one) and 0 <= one.min() <= one.max() < len(places) for one in own):
            middles = np.array([places[one].mean(axis=0) for one in own])
            return off_rim(middles - [centre.real, centre.imag], radius)
    return None


def _laid_out(
    path: Path, name: str, array: np.ndarray, order: str | None, drive: str, measure: str
) -> tuple[np.ndarray, Layout] | None:
    """Frames (F, width) and their layout, of rows that fit, else of columns that do; None of an
    array that can hold no readings."""
    if array.ndim != 2 or not array.size or array.dtype == np.uint8:  # logical, as meas_select
        return None
    if name.rpartition(".")[2] in NO_READINGS:
        return None
    bare_vectors.pairs(path, 2 * bare_vectors.FEWEST_GUESSED, drive, measure)
    for frames in (array.T, array):
        try:
            layout = bare_vectors.stepped(path, frames.shape[1], drive, measure, order)
        except InputError:
            continue
        return frames, layout
    return None


def _reference(path: Path, fitting: dict, found: dict) -> str:
    """The one array, or the one whose name says that it is the reference."""
    if len(fitting) == 1:
        return next(iter(fitting))
    named = [
        name for name in fitting if any(map(REFERENCE.fullmatch, re.split(r"[._]", name.lower())))
    ]
    if len(named) == 1:
        return named[0]
    several = shapes({name: found[name] for name in named or fitting})
    expected = "one whose name says that it is the reference: vh, v_homg, reference"
    raise InputError(path, "arrays", several, expected)
