"""Goe-MF's and Draeger's .get from samples written here."""

import numpy as np
import pytest

from eitskin.data import check, importers
from eitskin.errors import InputError
from homogeneous_skin import readings

HEADER = (
    b"---Draeger EIT-Software---\r\n---Protocol Data-----\r\n\r\nDate:  18-02-2004\r\n\r\n"
    b"Frequency [Hz]:    97656.3\r\nFrames:              10\r\n\r\n\r\n"
)
# Drive k, then the pairs from its own sink onwards: EIDORS reads them so.
FILED = [[k, (k + 1) % 16, (k + 1 + i) % 16, (k + i) % 16] for k in range(16) for i in range(2, 15)]


def frames(count=3, width=256):
    values = np.full((count, width), 0.01, dtype="<f4")
    values[:, :208] = np.linspace(1.0, 1.1, count)[:, None] * readings(FILED, 16)
    return values


def refused(path, match, **settings):
    with pytest.raises(InputError, match=match) as caught:
        importers.load(path, **settings)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("header", [b"", HEADER, HEADER.replace(b"\r\n", b"\n")])
@pytest.mark.parametrize(("count", "width"), [(3, 256), (3, 208), (13, 256), (16, 208)])
def test_readings_turn_with_the_drive(tmp_path, header, count, width):
    """13 frames of 256 are as long as 16 of 208: reciprocity tells them apart."""
    path = tmp_path / "tank.get"
    path.write_bytes(header + frames(count, width).tobytes())
    imported_recording = importers.load(path)
    assert imported_recording.channels.tolist() == FILED and imported_recording.voltage.shape == (
        count,
        208,
    )
    np.testing.assert_array_equal(imported_recording.voltage, frames(count, width)[:, :208])
    assert imported_recording.metadata["voltage"] == "magnitude", "no reading is below 0"
    assert check.check(imported_recording).ok and not imported_recording.frames["touch"].any()
    source = imported_recording.metadata["source"]
    assert ("48 of 256 numbers a frame left out" in source) == (width == 256)
    assert ("Draeger" in source) == bool(header)


def test_another_order_is_noticed_and_can_be_asked_for(tmp_path):
    path = tmp_path / "tank.get"
    values = frames()
    ascending = sorted(range(208), key=lambda k: (FILED[k][0], FILED[k][3]))
    values[:, :208] = values[:, ascending]
    path.write_bytes(values.tobytes())
    (finding,) = check.check(importers.load(path)).of_topic("order")
    assert finding.severity == check.ERROR and "--order drive-minus-ascending" in finding.sentence
    imported_recording = importers.load(path, order="drive-minus-ascending")
    assert imported_recording.channels.tolist() == [FILED[k] for k in ascending]
    assert "as told: order drive-minus-ascending" in imported_recording.metadata["source"]
    assert check.check(imported_recording).ok


def test_broken_files_are_refused(tmp_path):
    path = tmp_path / "tank.get"
    path.write_bytes(frames().tobytes()[:-5])
    refused(path, "3067 bytes, expected whole frames of 256")
    path.write_bytes(HEADER + frames().tobytes()[:-4])
    refused(path, "3068 bytes after the header")
    for content, match in (
        (b"", "0 bytes"),
        (HEADER, "0 bytes after the header"),
        (HEADER[:-4], "two empty lines"),
        (b"1.0 2.0 3.0\n" * 256, "found text"),
    ):
        path.write_bytes(content)
        refused(path, match)
    values = frames()
    values[1, 5] = np.inf
    path.write_bytes(values.tobytes())
    refused(path, "row 1: found inf in channel 5")
    path.write_bytes(frames().tobytes())
    refused(path, "setting measure: .*draeger-get states its own", measure="adjacent")
