"""Any bytes in any importer's way: a recording or one line, never anything else."""

from functools import cache

import numpy as np
import pytest
import scipy.io
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eitskin.data import importers
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table
from homogeneous_skin import potentials, readings

DESCRIPTION = {"drive": "adjacent", "measurement": "adjacent", "labels": {"time_s": 0}}


def eit(path):
    header = ["11", "2", "skin", "2023.01.05. 14:36:10.000", "1000", "1000", "0", "1", "0.001", "9"]
    lines = [*header, "0"]
    for k in range(8):
        lines.append(f"{k + 1} {(k + 1) % 8 + 1}")
        values = potentials((k, (k + 1) % 8), 8)
        lines.append("\t".join(f"{u.real:.6E}\t{u.imag:.6E}" for u in values))
    path.write_text("\n".join(lines) + "\n")


def matrix(path, save):
    table = np.hstack([[[0.0], [0.5]], readings(channel_table(8), 8) * [[1.0], [1.1]]])
    save(path, table)
    path.with_suffix(".yaml").write_text(yaml.safe_dump(DESCRIPTION))


SAMPLES = {
    "a.eit": eit,
    "a.get": lambda path: path.write_bytes(np.linspace(0, 1, 512).astype("<f4").tobytes()),
    "a.mat": lambda path: scipy.io.savemat(path, {"vh": readings(channel_table(8), 8)[:, None]}),
    "a.csv": lambda path: matrix(path, lambda file, t: np.savetxt(file, t, delimiter=",")),
    "a.npy": lambda path: matrix(path, np.save),
    "a.npz": lambda path: matrix(path, np.savez),
}


@cache
def sample(name, folder):
    """The bytes of a good file and of its description."""
    SAMPLES[name](folder / name)
    made = importers.load(folder / name)
    assert made.voltage.size
    description = folder / "a.yaml"
    return (folder / name).read_bytes(), description.read_bytes() if description.is_file() else None


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A folder a sample."""
    return {name: tmp_path_factory.mktemp(name.replace(".", "-")) for name in SAMPLES}


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
@pytest.mark.parametrize("name", SAMPLES)
def test_spoiled_files_are_read_or_refused_in_one_line(folders, name, data):
    folder = folders[name]
    whole, description = sample(name, folder)
    spoiled = bytearray(whole if data.draw(st.booleans()) or description is None else description)
    target = folder / (name if bytes(spoiled) == whole else "a.yaml")
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, max(0, len(spoiled) - 1)))
        kind = data.draw(st.sampled_from(["cut", "byte", "out", "twice"]))
        if kind == "cut":
            del spoiled[at:]
        elif kind == "byte" and spoiled:
            spoiled[at] = data.draw(st.integers(0, 255))
        elif kind == "out":
            del spoiled[at : at + data.draw(st.integers(1, 40))]
        else:
            spoiled[at:at] = spoiled[at : at + 40]
    target.write_bytes(spoiled)
    try:
        made = importers.load(folder / name)
        assert made.voltage.shape == (len(made.frames), len(made.channels))
    except InputError as error:
        assert "\n" not in str(error) and "found" in str(error)
    finally:
        (folder / name).write_bytes(whole)
        if description is not None:
            (folder / "a.yaml").write_bytes(description)
