"""What a file does not say of its channels, said on the command line."""

import numpy as np
import pytest
import scipy.io

from eitskin import cli
from eitskin.data import recording
from eitskin.data.channel_order import ORDERS, in_order
from eitskin.physics.protocol import channel_table
from homogeneous_skin import readings


@pytest.fixture
def stored(make_recording, tmp_path):
    """A function that writes a recording whose readings stand in another order than it says."""

    def write(order):
        made = make_recording()
        permutation = ORDERS[order].permutation(made.channels, 16)
        made.voltage = np.ascontiguousarray(made.voltage[:, permutation])
        path = tmp_path / "skin.parquet"
        recording.write(made, path)
        return path

    return write


def test_what_check_tells_to_type_makes_the_recording_right(stored, tmp_path, capsys):
    path, out = stored("drive-plus-ascending-own"), tmp_path / "right.parquet"
    assert cli.main(["check", str(path)]) == cli.UNUSABLE
    printed = capsys.readouterr().out
    assert f"read as '{ORDERS['drive-plus-ascending-own'].sentence}'" in printed
    option = printed.split("To read it so: ")[1].split(" (in config.yaml")[0].split()
    assert option == ["--order", "drive-plus-ascending-own"]
    assert cli.main(["check", str(path), *option]) == 0
    assert cli.main(["import", str(path), str(out), *option]) == 0
    before, after = recording.read(path), recording.read(out)
    np.testing.assert_array_equal(after.voltage, before.voltage)
    expected = in_order(path, option[1], before.channels, 16)
    np.testing.assert_array_equal(after.channels, expected)
    assert after.metadata["source"] == ("simulation (as told: order drive-plus-ascending-own)")


@pytest.mark.parametrize("name", ORDERS)
def test_every_order_has_a_name_that_says_what_its_sentence_says(name):
    order = ORDERS[name]
    channels = channel_table(8)
    permuted = in_order("", name, channels, 8)
    assert sorted(permuted.tolist()) == channels.tolist()
    slow, end = (0 if name.startswith("drive") else 2), ["source", "sink", "plus", "minus"]
    column = end.index(order.end)
    steps = np.diff(permuted[:, slow])
    assert ((steps <= 0) if "reversed" in name else (steps >= 0)).all()
    fast = permuted[:, column] - (permuted[:, slow] if name.endswith("own") else 0)
    inside = np.diff(fast % 8)[steps == 0]
    assert ((inside < 0) if "descending" in name else (inside > 0)).all()
    assert order.sentence.startswith(f"{order.slow} by {order.slow}") and order.end in name


def test_pairs_are_named_where_the_file_does_not(tmp_path, capsys):
    path, out = tmp_path / "skin.mat", tmp_path / "skin.parquet"
    table = channel_table(16, "opposite")
    scipy.io.savemat(path, {"v": readings(table, 16)[:, None]})
    assert cli.main(["check", str(path)]) == 1
    assert "--drive and --measure" in capsys.readouterr().err
    pairs = ["--drive", "opposite", "--measure", "adjacent"]
    assert cli.main(["check", str(path), *pairs]) == 0
    assert cli.main(["import", str(path), str(out), *pairs]) == 0
    np.testing.assert_array_equal(recording.read(out).channels, table)


@pytest.mark.parametrize(
    ("option", "match"),
    [
        (["--order", "upwards"], "order: found 'upwards', expected one of drive-plus-ascending"),
        (
            ["--drive", "opposite"],
            "setting drive: found 'opposite', expected none: the format eit",
        ),
        (["--measure", "adjacent"], "setting measure: found 'adjacent', expected none"),
    ],
)
@pytest.mark.parametrize("command", ["check", "import", "diagnose"])
def test_a_setting_that_is_none_is_one_line(stored, tmp_path, capsys, command, option, match):
    path = stored("drive-plus-ascending")
    rest = [str(tmp_path / "out.parquet")] if command == "import" else []
    assert cli.main([command, str(path), *rest, *option]) == 1
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and match in printed
    assert list(tmp_path.iterdir()) == [path]
