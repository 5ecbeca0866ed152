"""Goettingen (Goe-MF, Viasys) and older Draeger `.get` files: frames of little-endian float32.

By EIDORS (eidors3d, `eidors_readdata`, formats `mceit` and `draeger-get`): a frame is 256 numbers,
208 readings, then 16 currents and 16 voltages of the drives and 16 others; Draeger's begins with a
text, `---Draeger EIT-Software---`, that ends with two empty lines. Files of readings alone have
frames of 208. 16 electrodes, adjacent drive and measurement; readings turn with the drive: drive k
is (k, k+1), its 13 pairs (j, j+1) are j = k+2 ... k+14, wrapping round. A homogeneous disc reads
positive: u[j+1] - u[j]. Neither scale nor frame rate is in the file, nor who touched when: the
frames are taken for untouched.
"""

from pathlib import Path

import numpy as np

from eitskin.data.channel_order import in_order, misfit
from eitskin.data.importers import bare_vectors
from eitskin.data.importers.bare_vectors import Layout
from eitskin.data.importers.description import swap_measured
from eitskin.data.recording import Recording
from eitskin.errors import InputError
from eitskin.physics.protocol import channel_table

MARK = b"---Draeger EIT-Software---"
BINARY = b"\n**"  # ends the text of the newer format, whose frames are not of float32 alone
ENDS = (b"\r\n\r\n\r\n", b"\n\n\n")  # of Draeger's text
N_ELECTRODES = 16
ORDER = "drive-plus-ascending-own"
WIDTHS = (256, 208)
SOURCE = "{maker} .get file {name} ({remarks})"


def matches(path: Path) -> bool:
    """Whether the file begins as Draeger's do, or is named as the others, which have no mark."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(len(MARK)) == MARK or path.suffix.lower() == ".get"


def load(path: Path) -> Recording:
    """All frames; raises InputError for a text without numbers and a file cut short."""
    content = path.read_bytes()
    maker = "Draeger" if content.startswith(MARK) else "Goe-MF"
    if content.startswith(MARK):
        text_end = min((content.find(end) + len(end) for end in ENDS if end in content), default=0)
        if not text_end:
            if BINARY in content:
                expected = "a .get, or a .mat of it (EIDORS: eidors_readdata, save -v7)"
                raise InputError(
                    path, "format", "Draeger's binary .eit, which is not read", expected
                )
            raise InputError(path, "header", "no end", "two empty lines before the numbers")
        content = content[text_end:]
    elif content and content.isascii() and "".join(content.decode("ascii").split()).isprintable():
        raise InputError(path, "file", "text", "frames of float32")
    if not content or len(content) % 4 or not _widths(content):
        size_text = f"{len(content)} bytes" + " after the header" * (maker == "Draeger")
        expected = "whole frames of 256 (1024 bytes) or of 208 float32 (832 bytes)"
        raise InputError(path, "file", size_text, expected)
    channels = swap_measured(in_order(path, ORDER, channel_table(N_ELECTRODES), N_ELECTRODES))
    width = min(
        _widths(content), key=lambda width_option: _broken(_frames(content, width_option), channels)
    )
    frames = _frames(content, width)
    omitted = f"{width - 208} of {width} numbers a frame left out, currents and other" * (
        width > 208
    )
    remarks = bare_vectors.join_remarks(bare_vectors.UNTOUCHED, omitted)
    layout = Layout(N_ELECTRODES, channels, np.arange(len(channels)), width)
    return bare_vectors.untouched_recording(
        frames, layout, SOURCE.format(maker=maker, name=path.name, remarks=remarks)
    )


def _widths(content: bytes) -> list[int]:
    """Widths of frames that divide the content."""
    return [width for width in WIDTHS if len(content) % (4 * width) == 0]


def _frames(content: bytes, width: int) -> np.ndarray:
    return np.frombuffer(content, dtype="<f4").reshape(-1, width).astype(float)


def _broken(frames: np.ndarray, channels: np.ndarray) -> float:
    """Misfit of reciprocity of the first readings of frames; infinite where there is none."""
    values = np.abs(frames[:, : len(channels)])
    with np.errstate(over="ignore", invalid="ignore"):
        reciprocity = misfit(values, channels, N_ELECTRODES, False).reciprocity
    return np.inf if reciprocity is None or not np.isfinite(reciprocity) else reciprocity
