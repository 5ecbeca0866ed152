"""MATLAB files of EIDORS: readings x frames, real or complex, under any name or within structures.

EIDORS (eidors3d, `mk_stim_patterns`, `eidors_readdata`, `fwd_solve`) holds frames as columns: 208
rows of 16 electrodes, adjacent drive and measurement, drive by drive in ascending order
(`no_rotate_meas`), or 256 with the readings at driven electrodes, which `meas_select` takes out; a
data object has them in its field `meas`. A homogeneous disc reads positive there: u[j+1] - u[j]
with current entering at k. Other numbers of electrodes and other pairs: `drive`, `measure`.

Where a forward model in the file has its `stimulation`, that is the channel table: `stim_pattern`
and `meas_pattern` of every drive, unless `drive` or `measure` is given.

Of several such arrays the named one is read, or the one whose name says that it is the reference
(`vh`, `v_homg`, `ref...`, `array_choice`); the others, objects at places that nobody wrote down,
are neither touches at known places nor untouched frames and are left out. Frames are nobody's
touches: they are taken for untouched.

A forward model in the file (`nodes`, `electrode(k).nodes`) says what the outline is, and whether
electrodes lie off the rim; its unit is nobody's, so that no size is taken from it.
"""

import re
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from eitskin.data.importers import array_choice, bare_vectors
from eitskin.data.importers.array_choice import shapes
from eitskin.data.importers.bare_vectors import REVERSED, Layout
from eitskin.data.importers.matlab_file import arrays, is_matlab
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics.outline import described, off_rim, ring

LEFT_OPEN = ("order", "drive", "measure", "array")
DRIVE, MEASURE = "adjacent", f"adjacent{REVERSED}"
NO_READINGS = ("nodes", "elems", "boundary", "elem_data", "node_data")  # of EIDORS's models
SOURCE = "EIDORS's MATLAB file {name}, array {array} ({remarks})"


def matches(path: Path) -> bool:
    """Whether it is a MATLAB file; `load` checks its arrays."""
    return is_matlab(path)


def load(
    path: Path,
    order: str | None = None,
    drive: str | None = None,
    measure: str | None = None,
    array: str | None = None,
) -> Recording:
    """A frame a column; raises InputError where no array, or not one alone, can be the readings."""
    file_arrays = arrays(path)
    tables = {} if drive or measure else _stimulations(path, file_arrays)
    drive, measure = drive or DRIVE, measure or MEASURE
    candidates = {}
    for name, file_array in file_arrays.items():
        frames_and_layout = _stated_layout(path, name, file_array, order, tables)
        if frames_and_layout is None:
            frames_and_layout = _candidate_layout(path, name, file_array, order, drive, measure)
        if frames_and_layout is not None:
            candidates[name] = frames_and_layout
    if not candidates:
        expected = (
            f"one array of n (n - 3) or n n rows (208 or 256 of 16 electrodes), a frame a column, "
            f"for drive {drive!r}, measure {measure!r}; --drive and --measure name other pairs"
        )
        raise InputError(path, "arrays", shapes(file_arrays), expected)
    name, omitted = array_choice.choice(
        path, {name: file_arrays[name] for name in candidates}, array, file_arrays
    )
    frames, layout, by_stimulation = candidates[name]
    if order is None and not by_stimulation:
        bare_vectors.refuse_other_order(path, frames, drive, measure, layout)
    stated = "channels by fwd_model.stimulation" if by_stimulation else ""
    remarks = bare_vectors.join_remarks(bare_vectors.UNTOUCHED, stated, layout.left_out, omitted)
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
) -> tuple[np.ndarray, Layout, bool] | None:
    """Frames (F, width) and their layout, by columns or else by rows of an array; None where
    neither fits."""
    if not _may_be_readings(name, array):
        return None
    bare_vectors.pattern_channels(path, 2 * bare_vectors.MIN_GUESSED_ELECTRODES, drive, measure)
    for frames in (array.T, array):
        try:
            layout = bare_vectors.pattern_layout(path, frames.shape[1], drive, measure, order)
        except InputError:
            continue
        return frames, layout, False
    return None


def _stated_layout(
    path: Path, name: str, array: np.ndarray, order: str | None, tables: dict[str, np.ndarray]
) -> tuple[np.ndarray, Layout, bool] | None:
    """Frames (F, width) and their layout by a stimulation in the file, that of the same structure
    before others; None where none has as many channels."""
    if not _may_be_readings(name, array):
        return None
    root = name.partition(".")[0]
    for model in sorted(tables, key=lambda model: model.partition(".")[0] != root):
        for frames in (array.T, array):
            if frames.shape[1] == len(tables[model]):
                table = tables[model].tolist()
                return frames, bare_vectors.channel_layout(path, len(table), table, order), True
    return None


def _may_be_readings(name: str, array: np.ndarray) -> bool:
    is_numeric = array.ndim == 2 and array.size and array.dtype != np.uint8  # logical: meas_select
    return bool(
        is_numeric and name.rpartition(".")[2] not in NO_READINGS and ".stimulation" not in name
    )


def _stimulations(path: Path, file_arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Channels (M, 4) by the model whose `stimulation` states them, drive by drive.

    Raises InputError where a drive or a measurement is of other than two electrodes.
    """
    rows: dict[str, list[list[int]]] = {}
    for name, drive in file_arrays.items():
        stimulation, _, field = name.rpartition(".")
        if field != "stim_pattern" or ".stimulation" not in f".{stimulation}":
            continue
        measured = file_arrays.get(f"{stimulation}.meas_pattern")
        if measured is None:
            continue
        source, sink = _pair(path, name, drive.ravel())
        pairs = [_pair(path, f"{stimulation}.meas_pattern", row) for row in np.atleast_2d(measured)]
        model = stimulation.partition("stimulation")[0]
        rows.setdefault(model, []).extend([source, sink, plus, minus] for plus, minus in pairs)
    return {model: np.array(channels) for model, channels in rows.items()}


def _pair(path: Path, place: str, weights: np.ndarray) -> tuple[int, int]:
    """The positive and the negative electrode of a pattern (n,) of two equal weights."""
    ends = np.flatnonzero(weights)
    if len(ends) != 2 or not np.isclose(weights[ends].sum(), 0.0):
        found = f"{len(ends)} electrodes of weights {np.round(weights[ends][:4], 6).tolist()}"
        raise InputError(
            path, place, found, "two of opposite weights, as a four-electrode reading has"
        )
    plus, minus = (int(end) for end in sorted(ends, key=lambda end: -weights[end]))
    return plus, minus
