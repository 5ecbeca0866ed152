"""Kuopio Tomography Challenge 2023: `ref.mat` (`Injref`, `Mpat`, `Uelref`), `data<k>.mat` (`Inj`,
`Mpat`, `Uel`).

A tank of 32 electrodes. By the organisers' code (`main.m`, `KTCFwd.py`, `setMeasurementPattern.m`;
rules at fips.fi/KTCrules.php): `Inj` (32, K) holds the currents of K injections, 76, each between
two electrodes, and of an amplitude of its own near 1.5; `Mpat` (32, P) the P measured differences,
31, `Mpat' U`; `Uel` (P K, 1) stands injection by injection. A reading is divided by its injection's
current, so that all share one factor, and taken where neither measured electrode drives.

`Uelref` is the tank without objects. `Uel` has objects at places that are given as images alone:
it is no touch at a known place and no untouched frame, so it is left out, and `source` says so.
"""

from pathlib import Path

import numpy as np

from eitskin.data.importers.array_choice import shapes
from eitskin.data.importers.bare_vectors import join_remarks
from eitskin.data.importers.description import describe
from eitskin.data.importers.matlab_file import arrays, is_matlab
from eitskin.data.recording import Recording, frames_table
from eitskin.errors import InputError
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import undriven

CURRENTS = ("Injref", "Inj")
SOURCE = "Kuopio Tomography Challenge 2023, {name} (Uelref, the tank without objects{remarks})"


def matches(path: Path) -> bool:
    """Whether it is a MATLAB file with injections, measured pairs and voltages."""
    try:
        names = set(arrays(path)) if is_matlab(path) else set()
    except InputError:
        return False
    return "Mpat" in names and bool(names & {*CURRENTS}) and bool(names & {"Uel", "Uelref"})


def load(path: Path) -> Recording:
    """A frame a column of Uelref; raises InputError where there is none or the arrays do not fit
    together."""
    file_arrays = arrays(path)
    if "Uelref" not in file_arrays and "Uel" in file_arrays:
        contents = "Uel alone: objects at places that nobody wrote down"
        raise InputError(
            path, "arrays", contents, "Uelref, the tank without objects, as in ref.mat"
        )
    names = [next((name for name in CURRENTS if name in file_arrays), "Injref"), "Mpat", "Uelref"]
    if not {*names} <= file_arrays.keys():
        raise InputError(path, "arrays", shapes(file_arrays), f"{', '.join(names)}")
    currents, measured_pairs = (file_arrays[name].astype(float) for name in names[:2])
    if currents.shape[0] != measured_pairs.shape[0]:
        contents = f"{len(currents)} electrodes in {names[0]}, {len(measured_pairs)} in Mpat"
        raise InputError(path, "Mpat", contents, "as many")
    drives, amplitudes = _pairs(path, names[0], currents)
    measurements, gains = _pairs(path, "Mpat", measured_pairs)
    shape = (len(drives), len(measurements))
    voltages = _voltages(path, file_arrays["Uelref"], shape)
    channels = np.concatenate(
        [np.repeat(drives, shape[1], axis=0), np.tile(measurements, (shape[0], 1))], axis=1
    )
    readings = voltages / (np.repeat(amplitudes, shape[1]) * np.tile(gains, shape[0]))
    is_undriven = undriven(channels)
    parts = join_remarks(
        "each reading over its injection's current",
        f"{np.sum(~is_undriven)} readings at driven electrodes left out"
        if not is_undriven.all()
        else "",
        "Uel left out: objects at places that nobody wrote down" if "Uel" in file_arrays else "",
    )
    n = len(currents)
    source = SOURCE.format(name=path.name, remarks=f"; {parts}")
    metadata = describe(channels[is_undriven], even_angles(n), source, "signed")
    frames = frames_table(np.arange(len(readings)), np.zeros(len(readings), dtype=bool))
    return Recording(frames, readings[:, is_undriven], None, None, metadata)


def _pairs(path: Path, name: str, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Electrodes (K, 2), positive then negative, and amplitudes (K,) of columns (E, K)."""
    positive, negative = table.argmax(axis=0), table.argmin(axis=0)
    column = np.arange(table.shape[1])
    high, low = table[positive, column], table[negative, column]
    is_balanced = np.isclose(high, -low, rtol=0.05, atol=0.0) & (high > 0)
    bad_columns = np.flatnonzero(~is_balanced | ((table != 0).sum(axis=0) != 2))
    if len(bad_columns):
        k = int(bad_columns[0])
        values = table[table[:, k] != 0, k]
        violation = f"{len(values)} electrodes, {np.array2string(values[:4], precision=4)}"
        raise InputError(path, f"{name}, column {k}", violation, "two, one + and one - alike")
    return np.stack([positive, negative], axis=1), 0.5 * (high - low)


def _voltages(path: Path, array: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Voltages (F, K P), injection by injection, from an array (K P, F) or one frame (P, K)."""
    n_injections, n_measurements = shape
    if array.dtype.kind == "c":
        raise InputError(path, "Uelref", "complex numbers", "real ones")
    if array.shape == (n_measurements, n_injections):
        return array.astype(float).ravel(order="F")[None]
    if array.ndim == 2 and array.shape[0] == n_measurements * n_injections:
        return array.astype(float).T
    n_rows = n_measurements * n_injections
    expected = f"{n_rows} rows: {n_injections} injections of {n_measurements} differences"
    raise InputError(path, "Uelref", array.shape, expected)
