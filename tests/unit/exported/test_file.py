"""An exported predictor's file: whole, the same bytes again, and nothing in it runs."""

import json
import pickle
import zipfile

import numpy as np
import pytest

import streamed_skin as skin
from eitskin.errors import InputError
from eitskin.exported import file, predictor
from eitskin.exported.predictor import Predictor
from eitskin.learn import predict

pytestmark = pytest.mark.xdist_group("streamed")  # one predictor, trained in seconds


class Bomb:
    def __reduce__(self):
        return (print, ("it runs",))


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "mlp.npz"
    file.write(skin.exported(), path)
    return path


def test_what_is_read_says_what_was_trained(path):
    change = skin.dataset().delta_V[skin.part() == "test"][:50].astype(float)
    exported_predictor = Predictor(file.read(path))
    expected = predict.predict_seeds(skin.trained(), change)[0]
    np.testing.assert_allclose(exported_predictor.states(change), expected, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(
        exported_predictor.states(change[:1])[0], expected[0], rtol=1e-5, atol=1e-4
    )
    strange = np.concatenate([change, -change, 10 * change, 0.01 * change])
    gates = predict.judge(skin.trained(), strange)
    assert gates["touch"].nunique() == gates["abstain"].nunique() == 2
    for frame, touch, abstain in zip(strange, gates["touch"], gates["abstain"], strict=True):
        assert (exported_predictor.touched(frame), not exported_predictor.familiar(frame)) == (
            touch,
            abstain,
        )


def test_equal_contents_equal_bytes(path, tmp_path):
    file.write(file.read(path), tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()


def test_a_pickle_in_it_is_refused_and_does_not_run(path, capsys):
    with zipfile.ZipFile(path, "a") as archive:
        descr = b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '|O', 'fortran_order': False, 'shape': ()}"
        archive.writestr("bomb.npy", descr.ljust(127) + b"\n" + pickle.dumps(Bomb()))
    with pytest.raises(InputError, match="found another content, expected an exported predictor"):
        file.read(path)
    assert capsys.readouterr().out == ""


def changed(path, change):
    """The file with another header."""
    with np.load(path) as archive:
        arrays = dict(archive)
    header = json.loads(arrays["header"].tobytes())
    change(header, arrays)
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda header, arrays: header.update(version=2), "found 'eitskin-predictor', 2"),
        (lambda header, arrays: header.pop("intervals"), "header.intervals: found nothing"),
        (lambda header, arrays: header.update(graphs={"states": 3}), "header.graphs: found"),
        (lambda header, arrays: header["graphs"].pop("without"), "found no without"),
        (lambda header, arrays: arrays.pop("precision"), "array precision: found nothing"),
        (
            lambda header, arrays: header["graphs"]["states"]["steps"][0].__setitem__(1, "eval"),
            r"header.graphs.states: found eval, expected a known operation",
        ),
        (lambda header, arrays: header["touch"].clear(), "header.touch.threshold: found nothing"),
        (lambda header, arrays: header.update(familiar=3), "header.familiar.limit_distance: found"),
        (lambda header, arrays: header["dataset"].pop("name"), "header.dataset.name: found ''"),
        (
            lambda header, arrays: header["dataset"].pop("channels"),
            "header.dataset.channels: found",
        ),
        (
            lambda header, arrays: header["intervals"]["half"].pop(),
            r"header.intervals.half: found numbers of shape \(4, 3\), expected finite .* \(5, 3\)",
        ),
        (
            lambda header, arrays: arrays.update(scale=arrays["scale"][:7]),
            r"array scale: found numbers of shape \(7,\)",
        ),
        (
            lambda header, arrays: [arrays.pop(k) for k in list(arrays) if "states/" in k],
            "header.graphs.states: found no array states/",
        ),
        (
            lambda header, arrays: arrays.update(
                {k: v[:3] for k, v in arrays.items() if "states/" in k and v.ndim == 2}
            ),
            "graphs: found networks that cannot be applied",
        ),
    ],
)
def test_another_content_is_refused(path, change, said):
    changed(path, change)
    with pytest.raises(InputError, match=said):
        predictor.read(path)


def test_a_cut_file_and_another_file_are_refused(path, tmp_path):
    path.write_bytes(path.read_bytes()[:-100])
    (tmp_path / "text").write_text("no archive", encoding="utf-8")
    for name in ("mlp.npz", "text", "absent"):
        with pytest.raises(InputError, match="expected an exported predictor"):
            file.read(tmp_path / name)
