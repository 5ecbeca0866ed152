"""What a person at the bench reads while the rig captures."""

import io

from eitskin.capture.press_plan import Contact
from eitskin.capture.view import View

CONTACT = Contact(number=4, probe_mm=7.0, session="7 mm, 1", x_mm=10.0, y_mm=-20.0, target_N=8.5)
FRAME = {"force_N": 3.27, "zero_N": 0.02, "rejected_before": 2, "saturated": 1}
LINE = (
    "contact 5 of 576 · 7 mm at (10.0, -20.0) mm · press · depth 2.0 mm · 3.25 of 8.5 N · "
    "1 frames, 2 lines refused, 1 channels saturated · 01:02:03 left"
)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def shown_text(stream: io.StringIO) -> str:
    view = View(stream)
    view({"contact": CONTACT, "number": 5, "of": 576, "left_s": 3723.0})
    view({"phase": "press", "depth_mm": 2.0})
    view({"frame": FRAME})
    view({"phase": "up", "depth_mm": None})
    view.close()
    return stream.getvalue()


def test_a_terminal_has_one_line_that_is_written_over():
    parts = shown_text(Terminal()).split("\r")
    assert parts[3] == LINE
    assert parts[-1].endswith("\n")
    assert sum(part.count("\n") for part in parts) == 1


def test_elsewhere_there_is_one_line_a_contact():
    (line,) = shown_text(io.StringIO()).splitlines()
    assert line == LINE.replace("press", "up").replace(" · depth 2.0 mm", "")


def test_a_terminal_that_is_gone_does_not_hide_how_a_capture_ended(monkeypatch):
    stream = Terminal()
    view = View(stream)
    view({"contact": CONTACT, "number": 5, "of": 576, "left_s": None, "depth_mm": None})

    def gone():
        raise OSError("Input/output error")

    monkeypatch.setattr(stream, "flush", gone)
    view.close()
