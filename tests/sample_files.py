"""One small sound file of every format that is read, to be broken by tests."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import scipy.io

from eitskin.data import recording
from eitskin.data.importers.description import describe
from eitskin.data.recording import Recording, frames_table
from eitskin.physics.geometry import even_angles
from eitskin.physics.protocol import channel_table
from homogeneous_skin import potentials, readings

RING = channel_table(8)
RING_16 = channel_table(16)
FORCES_N = (0.0, 0.0, 1.0, 3.0, 5.0)
LOGGED = ("contact_idx", "contact_u_m", "contact_v_m", "depth_m", "force_n", "t_eit")


def made() -> Recording:
    """Our own format: two untouched frames, then one press."""
    force = np.array(FORCES_N)
    frames = frames_table(0.5 * np.arange(5), force > 0, 10.0, 5.0, force, 8.0)
    skin = {"radius_mm": 80.0, "current_A": 1e-3}
    metadata = describe(
        RING, even_angles(8), "a test", "signed", unit="V", clock="measured", skin=skin
    )
    voltage = np.outer(1.0 - 0.01 * force, readings(RING, 8))
    return Recording(frames, voltage, None, None, metadata)


def parquet(folder: Path) -> Path:
    """eit-recording."""
    recording.write(made(), folder / "skin.parquet")
    return folder / "skin.parquet"


@cache
def matrix_lines() -> tuple[str, ...]:
    """Rows of a matrix: time, then 40 readings."""
    rows = np.outer([1.0, 1.1, 1.2], readings(RING, 8))
    return tuple(",".join([f"{0.5 * k}", *map(repr, row.tolist())]) for k, row in enumerate(rows))


DESCRIPTION = """electrodes: 8
drive: adjacent
measurement: adjacent
labels: {time_s: 0}
"""


def matrix(folder: Path) -> Path:
    """matrix, as text with its description."""
    (folder / "frames.csv").write_text("\n".join(matrix_lines()) + "\n")
    (folder / "frames.yaml").write_text(DESCRIPTION)
    return folder / "frames.csv"


def numpy_matrix(folder: Path, save: Callable = np.save, name: str = "frames.npy") -> Path:
    """matrix, as NumPy's file with its description."""
    save(folder / name, np.array([line.split(",") for line in matrix_lines()], dtype=float))
    (folder / "frames.yaml").write_text(DESCRIPTION)
    return folder / name


def numpy_archive(folder: Path) -> Path:
    """matrix, as NumPy's archive."""
    return numpy_matrix(folder, np.savez, "frames.npz")


@cache
def logger_lines() -> tuple[str, ...]:
    """Names, then rows: contact, place, depth, force, time, 256 magnitudes."""
    values = np.zeros(256)
    values[16 * RING_16[:, 0] + RING_16[:, 2]] = np.abs(readings(RING_16, 16))
    lines = [",".join([*LOGGED, *(f"eit_{k}" for k in range(256))])]
    for k, force in enumerate(FORCES_N):
        row = [3, 0.02, -0.03, 0.001 * k, force, 5000.0 + k, *((1 - 0.01 * force) * values)]
        lines.append(",".join(f"{one:.9g}" for one in row))
    return tuple(lines)


def logger(folder: Path) -> Path:
    """logger-csv."""
    (folder / "press.csv").write_text("\n".join(logger_lines()) + "\n")
    return folder / "press.csv"


def hydrogel(folder: Path, **changes: object) -> Path:
    """hydrogel-skin; changes: other arrays."""
    ups = 1.0 + np.arange(96.0).reshape(3, 32)
    positions = np.array([[0.01, 0.02, 0.01], [-0.03, 0.0, 0.015], [0.0, -0.05, 0.02]])
    arrays = {"positions": positions, "responseups": ups, "responsedowns": 1.1 * ups}
    scipy.io.savemat(folder / "ohmc.mat", arrays | changes)
    return folder / "ohmc.mat"


def iirc(folder: Path, **changes: object) -> Path:
    """iirc-tank; changes: other arrays."""
    every = [(k, (k + 1) % 16, j, (j + 1) % 16) for k in range(16) for j in range(16)]
    reference = readings(every, 16)[:, None] * np.exp(0.1j)
    arrays = {"v_reference": reference, "v_rotate": np.hstack([reference, reference])}
    scipy.io.savemat(folder / "iirc.mat", arrays | changes)
    return folder / "iirc.mat"


def ktc(folder: Path, **changes: object) -> Path:
    """ktc-mat, of eight electrodes; changes: other arrays."""
    pairs = np.eye(8) - np.roll(np.eye(8), 1, axis=0)
    channels = [(k, (k + 1) % 8, j, (j + 1) % 8) for k in range(8) for j in range(7)]
    voltage = readings(channels, 8)[:, None]
    arrays = {"Injref": pairs, "Mpat": pairs[:, :7], "Uelref": voltage}
    scipy.io.savemat(folder / "ref.mat", arrays | changes)
    return folder / "ref.mat"


def eidors(folder: Path, **changes: object) -> Path:
    """eidors-mat; changes: other arrays."""
    scipy.io.savemat(folder / "vh.mat", changes or {"vh": -readings(RING_16, 16)[:, None]})
    return folder / "vh.mat"


@cache
def pyeidors_lines() -> tuple[str, ...]:
    """Rows of real and imaginary parts, the reference's, then the target's."""
    order = [
        (k, (k + 1) % 16, (k + 3 + i) % 16, (k + 2 + i) % 16) for k in range(16) for i in range(13)
    ]
    return tuple(f"{v!r},{0.1 * v!r},{2 * v!r},{0.2 * v!r}" for v in readings(order, 16).tolist())


def pyeidors(folder: Path) -> Path:
    """pyeidors-tank."""
    (folder / "tank.csv").write_text("\n".join(pyeidors_lines()) + "\n")
    return folder / "tank.csv"


@cache
def lct_lines() -> tuple[str, ...]:
    """A header of three lines, then rows of real and imaginary parts and current."""
    values = -readings(RING_16, 16)
    rows = [f"{v!r} {0.1 * v!r} 3e-4" for v in [*values.tolist(), float(values[-1])]]
    return ("#MEAS", "#Date 16/07/2004 16:25:38", "#Start", *rows)


def lct(folder: Path) -> Path:
    """lct-tank."""
    (folder / "water_1.txt").write_text("\n".join(lct_lines()) + "\n")
    return folder / "water_1.txt"


def lct_folder(folder: Path) -> Path:
    """lct-tank, two frames in a folder."""
    (folder / "water").mkdir(exist_ok=True)
    for k in (1, 2):
        text = "\n".join(lct_lines()).replace(":38", f":3{k}")
        (folder / "water" / f"water_{k}.txt").write_text(text + "\n")
    return folder / "water"


@cache
def patterned_lines() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Three rows of changes and three of places."""
    change = np.abs(np.sin(np.arange(3 * 192.0))).reshape(3, 192)
    places = np.array([[0.01, 0.02, 0.1], [-0.02, 0.0, 0.1], [0.0, 0.03, 0.1]])
    change, places = (
        tuple(",".join(map(repr, row)) for row in table.tolist()) for table in (change, places)
    )
    return change, places


def patterned(folder: Path) -> Path:
    """patterned-skin, a pair of files."""
    for name, lines in zip(("inp_a.csv", "out_a.csv"), patterned_lines(), strict=True):
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8-sig")
    return folder / "inp_a.csv"


@cache
def sciospec_lines() -> tuple[str, ...]:
    """A header of eleven lines, then two lines an injection."""
    header = ["11", "2", "skin", "2023.01.05. 14:36:10.000", "1000", "1000", "0", "1", "0.001", "9"]
    lines = [*header, "0"]
    for k in range(8):
        lines.append(f"{k + 1} {(k + 1) % 8 + 1}")
        values = potentials((k, (k + 1) % 8), 8)
        lines.append("\t".join(f"{u.real:.6E}\t{u.imag:.6E}" for u in values))
    return tuple(lines)


def sciospec(folder: Path) -> Path:
    """sciospec-eit."""
    (folder / "setup_00001.eit").write_text("\n".join(sciospec_lines()) + "\n")
    return folder / "setup_00001.eit"


def sciospec_folder(folder: Path) -> Path:
    """sciospec-eit, two frames in a folder."""
    (folder / "setup").mkdir(exist_ok=True)
    for k in (1, 2):
        text = "\n".join(sciospec_lines()).replace(":10.000", f":1{k}.000")
        (folder / "setup" / f"setup_0000{k}.eit").write_text(text + "\n")
    return folder / "setup"


def draeger(folder: Path) -> Path:
    """draeger-get: two frames of 208 numbers."""
    values = np.tile(np.linspace(0.1, 1.0, 208), 2)
    (folder / "breath.get").write_bytes(values.astype("<f4").tobytes())
    return folder / "breath.get"


SAMPLES = {  # by format; each writes into a folder and returns what to load
    "eit-recording": (parquet,),
    "matrix": (matrix, numpy_matrix, numpy_archive),
    "logger-csv": (logger,),
    "hydrogel-skin": (hydrogel,),
    "iirc-tank": (iirc,),
    "ktc-mat": (ktc,),
    "eidors-mat": (eidors,),
    "pyeidors-tank": (pyeidors,),
    "lct-tank": (lct, lct_folder),
    "patterned-skin": (patterned,),
    "sciospec-eit": (sciospec, sciospec_folder),
    "draeger-get": (draeger,),
}
