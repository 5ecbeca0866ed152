"""Meshes and protocols of pyEIT and EIDORS, in and out, so that their reconstructions run with the
derivatives of `eitskin.jacobian`.

pyEIT (Liu et al., SoftwareX 7, 2018) need not be installed to import this. A mesh of pyEIT here is
in mm. EIDORS (Adler & Lionheart, Physiol. Meas. 27, 2006) is reached by .mat files of a
forward model: nodes, elems, electrode, stimulation.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.io import savemat

from eitskin.atomic import atomic_path
from eitskin.data.importers import matlab_file
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry

if TYPE_CHECKING:
    from pyeit.eit.protocol import PyEITProtocol
    from pyeit.mesh import PyEITMesh

MESH_SIZE = 0.08  # of an edge, in radii
Z_CONTACT = 0.01  # of EIDORS, which a point electrode has and does not use


def pyeit_protocol(channels: np.ndarray) -> "PyEITProtocol":
    """The protocol of pyEIT that reads channels (M, 4), source, sink, plus, minus, in their order
    and with their sign.

    Raises InputError where drives are not in blocks of equally many channels, which pyEIT needs.
    """
    from pyeit.eit.protocol import PyEITProtocol

    starts = np.flatnonzero(np.any(np.diff(channels[:, :2], axis=0) != 0, axis=1)) + 1
    blocks = np.split(channels, starts)
    drives = np.array([block[0, :2] for block in blocks])
    if len({len(block) for block in blocks}) > 1 or len(np.unique(drives, axis=0)) < len(drives):
        expected = "drive by drive, equally many of each"
        raise InputError("channels", "order", f"{len(blocks)} blocks of drives", expected)
    measured = np.array([block[:, 2:] for block in blocks])
    return PyEITProtocol(drives, measured, np.ones(len(channels), bool))


def channels(protocol: "PyEITProtocol") -> np.ndarray:
    """(M, 4): source, sink, plus, minus of what a protocol of pyEIT reads, in its order."""
    count = protocol.meas_mat.shape[1]
    drives = np.repeat(protocol.ex_mat, count, axis=0)
    return np.hstack([drives, protocol.meas_mat.reshape(-1, 2)])


def pyeit_mesh(geometry: Geometry, mesh_size: float = MESH_SIZE) -> "PyEITMesh":
    """A mesh of pyEIT in mm, with point electrodes at the centres of the skin's, on its rim, which
    may be out of round; mesh_size: of an edge, in radii. Raises InputError for a skin that is no
    disc, and for electrodes inside."""
    from pyeit.mesh.wrapper import PyEITMesh, create

    if geometry.outline:
        raise InputError("skin", "outline", "a skin that is no disc", "a disc, for a mesh of pyEIT")
    if len(geometry.inner):
        actual, expected = "some inside the skin", "all on its rim, for a mesh of pyEIT"
        raise InputError("skin", "electrodes", actual, expected)
    angle = np.radians(geometry.electrode_deg)
    fixed = np.column_stack([np.cos(angle), np.sin(angle)])
    disc = create(len(angle), h0=mesh_size, p_fix=fixed)
    place = disc.node[:, 0] + 1j * disc.node[:, 1]
    mapped = np.abs(place) * geometry.rim(np.angle(place))
    node = np.column_stack([mapped.real, mapped.imag, np.zeros(len(mapped))])
    inner = int(np.argmin(np.abs(place)))
    return PyEITMesh(element=disc.element, node=node, el_pos=np.arange(len(angle)), ref_node=inner)


def discs(node: np.ndarray, element: np.ndarray) -> np.ndarray:
    """(E, 3): x_mm, y_mm, radius_mm of discs as large as the triangles (E, 3) of nodes (P, 2 or 3)
    in mm, at their centroids: the basis of `eitskin.jacobian` for an image on that mesh."""
    corners = np.asarray(node, float)[:, :2][element]
    (ax, ay), (bx, by) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    area = 0.5 * np.abs(ax * by - ay * bx)
    return np.column_stack([corners.mean(axis=1), np.sqrt(area / np.pi)])


def write_eidors(
    path: str | Path,
    node: np.ndarray,
    element: np.ndarray,
    electrodes: Sequence[int],
    channels: np.ndarray,
    jacobian: np.ndarray | None = None,
) -> None:
    """Write EIDORS' `fmdl` to a .mat file: nodes (P, 2) in mm, triangles (E, 3), the `electrodes`'
    nodes, channels (M, 4) as stimulation for 1 A, and beside it `J` (M, E) where there is one.

    In EIDORS: `load(path); fmdl = eidors_obj('fwd_model', fmdl);`, and `fmdl.jacobian =
    @(~, ~) J;` makes its reconstructions use ours.
    """
    drives = list(dict.fromkeys(map(tuple, channels[:, :2].tolist())))
    stimulation = []
    for drive in drives:
        rows = channels[(channels[:, :2] == drive).all(axis=1)]
        stimulation.append(
            {
                "stim_pattern": _pattern([drive], len(electrodes)).T,
                "meas_pattern": _pattern(rows[:, 2:], len(electrodes)),
                "stimulation": "Amp",
            }
        )
    model: dict[str, Any] = {
        "type": "fwd_model",
        "name": "eitskin",
        "nodes": np.asarray(node, float)[:, :2],
        "elems": np.asarray(element) + 1.0,
        "gnd_node": 1.0,
        "electrode": [
            {"nodes": float(node_number + 1), "z_contact": Z_CONTACT} for node_number in electrodes
        ],
        "stimulation": stimulation,
    }
    content: dict[str, Any] = {"fmdl": model}
    if jacobian is not None:
        content["J"] = jacobian
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        savemat(stream, content)


def read_eidors(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (P, 2) and triangles (E, 3) of the forward model in a .mat file of EIDORS up to v7, in
    its unit of length. Raises InputError where there is none, and for a model in space."""
    arrays = matlab_file.arrays(Path(path))
    for name, nodes in arrays.items():
        model = name.removesuffix("nodes")
        if name == f"{model}nodes" and f"{model}elems" in arrays:
            elements = arrays[f"{model}elems"].astype(int) - 1
            if elements.ndim != 2 or elements.shape[1] != 3:
                raise InputError(path, f"{model}elems", f"shape {elements.shape}", "(E, 3)")
            return nodes.astype(float)[:, :2], elements
    expected = "a forward model, with nodes and elems"
    raise InputError(path, "arrays", ", ".join(arrays) or "none", expected)


def _pattern(pairs: Any, count: int) -> np.ndarray:
    """(K, count): 1 at the first electrode of each pair, -1 at the second."""
    pattern = np.zeros((len(pairs), count))
    for row, (first, second) in enumerate(pairs):
        pattern[row, first] += 1.0
        pattern[row, second] -= 1.0
    return pattern
