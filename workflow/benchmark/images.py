"""Where pyEIT's reconstruction places touches, with its own matrix and with that of the corrected
simulator: `python -m benchmark.images docs/sample OUT.csv`.

The recording in the folder is diagnosed. Of each press the frame with the largest force, less the
mean of the untouched frames, is reconstructed by pyEIT's `JAC` (method kotre, P and LAMBDA) on one
mesh of the skin as believed: with pyEIT's matrix, of point electrodes on a homogeneous disc, and
with `eitskin.jacobian` of the corrected simulator; both divided by their largest singular value, so
that LAMBDA means the same. A touch is where the image is the centroid of what is above HALF of its
largest value. A line a press: its place, and the distance of both from it.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import pandas as pd

import eitskin
from eitskin import peers
from eitskin.data.recording import Recording, presses
from eitskin.physics.geometry import Geometry
from eitskin.simulators import Simulator

P, LAMBDA = 0.5, 0.01  # pyEIT's own example of a dynamic image
HALF = 0.5


def table(recorded: Recording, simulator: Simulator) -> pd.DataFrame:
    """x_mm, y_mm, force_N of every press, and the distance in mm of pyEIT's image from there with
    each matrix, `own_mm` and `ours_mm`."""
    from pyeit.eit.jac import JAC

    believed = Geometry.from_skin(Simulator.believed(recorded).skin)
    mesh = peers.pyeit_mesh(believed)
    discs = peers.discs(mesh.node, mesh.element)
    solver = JAC(mesh, peers.pyeit_protocol(recorded.channels))
    solver.setup(p=P, lamb=LAMBDA, method="kotre")
    # pyEIT's matrix is minus the derivative.
    matrices = {
        "own_mm": solver.J,
        "ours_mm": -eitskin.jacobian(recorded, simulator, discs).matrix,
    }
    frames, press = recorded.frames, presses(recorded)
    quiet = np.nanmean(recorded.readings[press < 0], axis=0)
    rows = []
    for number in range(press.max() + 1):
        row = int(frames["force_N"].where(press == number).idxmax())
        place = frames.loc[row, ["x_mm", "y_mm"]].to_numpy(float)
        distances = {}
        for name, matrix in matrices.items():
            scaled = matrix / np.linalg.norm(matrix, 2)
            solver.H = solver._compute_h(scaled, P, LAMBDA, "kotre")
            image = np.abs(solver.solve(recorded.readings[row], quiet))
            weight = np.where(image >= HALF * image.max(), image * discs[:, 2] ** 2, 0.0)
            distances[name] = float(np.linalg.norm(weight @ discs[:, :2] / weight.sum() - place))
        force_N = float(frames["force_N"][row])
        rows.append({"x_mm": place[0], "y_mm": place[1], "force_N": force_N, **distances})
    return pd.DataFrame(rows)


def main() -> int:
    """Write the table; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmark.images", description=__doc__)
    parser.add_argument("folder")
    parser.add_argument("out")
    arguments = parser.parse_args()
    recorded = eitskin.read(Path(arguments.folder) / "recording.parquet")
    simulator = eitskin.diagnose(recorded).simulator
    table(recorded, simulator).to_csv(arguments.out, index=False, float_format="%.3f")
    return 0


if __name__ == "__main__":
    sys.exit(main())
