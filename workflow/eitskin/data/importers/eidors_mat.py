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
SOURCE = "EIDORS's MATLAB file {name}, array {array} ({remarks})"


def matches(path: Path) -> bool:
    """Whether it is a MATLAB file; `load` checks its arrays."""
    return is_matlab(path)


def load(
    path: Path, order: str | None = None, drive: str | None = None, measure: str | None = None
) -> Recording:
    """A frame a column; raises InputError where no array, or not one alone, can be the readings."""
    drive, measure = drive or DRIVE, measure or MEASURE
    file_arrays = arrays(path)
    candidates = {}
    for name, array in file_arrays.items():
        frames_and_layout = _candidate_layout(path, name, array, order, drive, measure)
        if frames_and_layout is not None:
            candidates[name] = frames_and_layout
    if not candidates:
        expected = (
            f"one array of n (n - 3) or n n rows (208 or 256 of 16 electrodes), a frame a column, "
            f"for drive {drive!r}, measure {measure!r}; --drive and --measure name other pairs"
        )
        raise InputError(path, "arrays", shapes(file_arrays), expected)
    name = _reference(path, candidates, file_arrays)
    frames, layout = candidates.pop(name)
    if order is None:
        bare_vectors.refuse_other_order(path, frames, drive, measure, layout)
    omitted = f"{', '.join(candidates)} left out, objects at unknown places" if candidates else ""
    remarks = bare_vectors.join_remarks(bare_vectors.UNTOUCHED, layout.left_out, omitted)
    imported_recording = bare_vectors.untouched_recording(
        frames, layout, SOURCE.format(name=path.name, array=name, remarks=remarks)
    )
    outline = _outline(file_arrays)
    if outline is not None:
        imported_recording.metadata["skin"]["outline"] = outline
    return imported_recording


def _outline(file_arrays: dict[str, np.ndarray]) -> str | None:
    """The outline in words of a forward model that is no disc with electrodes on its rim.

    By the convex hull of the nodes, seen along z; None for a disc and without a model.
    """
    for name, nodes in file_arrays.items():
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
        electrode_name = re.compile(re.escape(model) + r"\.electrode(\(\d+\))?\.nodes")
        electrode_nodes = [
            file_arrays[nodes_of_electrode].ravel().astype(int) - 1
            for nodes_of_electrode in file_arrays
            if electrode_name.fullmatch(nodes_of_electrode)
        ]
        if electrode_nodes and all(
            len(nodes_of_electrode)
            and 0 <= nodes_of_electrode.min() <= nodes_of_electrode.max() < len(places)
            for nodes_of_electrode in electrode_nodes
        ):
            electrode_centres = np.array(
                [places[nodes_of_electrode].mean(axis=0) for nodes_of_electrode in electrode_nodes]
            )
            return off_rim(electrode_centres - [centre.real, centre.imag], radius)
    return None


def _candidate_layout(
    path: Path, name: str, array: np.ndarray, order: str | None, drive: str, measure: str
) -> tuple[np.ndarray, Layout] | None:
    """Frames (F, width) and their layout, by columns or else by rows of an array; None where
    neither fits."""
    if array.ndim != 2 or not array.size or array.dtype == np.uint8:  # logical, as meas_select
        return None
    if name.rpartition(".")[2] in NO_READINGS:
        return None
    bare_vectors.pattern_channels(path, 2 * bare_vectors.MIN_GUESSED_ELECTRODES, drive, measure)
    for frames in (array.T, array):
        try:
            layout = bare_vectors.pattern_layout(path, frames.shape[1], drive, measure, order)
        except InputError:
            continue
        return frames, layout
    return None


def _reference(path: Path, candidates: dict, file_arrays: dict) -> str:
    """Name of the only candidate, or of the only one named as a reference."""
    if len(candidates) == 1:
        return next(iter(candidates))
    reference_names = [
        name
        for name in candidates
        if any(map(REFERENCE.fullmatch, re.split(r"[._]", name.lower())))
    ]
    if len(reference_names) == 1:
        return reference_names[0]
    shape_text = shapes({name: file_arrays[name] for name in reference_names or candidates})
    expected = "one whose name says that it is the reference: vh, v_homg, reference"
    raise InputError(path, "arrays", shape_text, expected)
