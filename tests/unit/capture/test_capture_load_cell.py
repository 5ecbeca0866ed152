"""Lines of load cells: what the firmware prints is read, anything else is refused, nothing
crashes."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.capture.load_cell import Restart, hx711_newtons, openscale_newtons


@settings(max_examples=2000)
@given(st.binary(max_size=100))
def test_any_bytes_are_read_or_refused_without_a_crash(line):
    hx711_newtons(line)
    openscale_newtons(line)


@pytest.mark.parametrize(
    ("line", "newtons"),
    [
        (b"-0.0012\r\n", -0.0012),
        (b"0.0000\r\n", 0.0),
        (b"9.8100\r\n", 9.81),
        (b"98.1000\r\n", 98.1),
    ],
)
def test_the_load_cell_of_the_paper(line, newtons):
    assert hx711_newtons(line) == newtons


def test_a_load_cell_that_greets_has_restarted():
    assert isinstance(hx711_newtons(b"Load cell ready. Readings in Newtons (N):\r\n"), Restart)
    assert isinstance(openscale_newtons(b"Serial Load Cell Converter version 1.2\r\n"), Restart)


def test_an_openscale():
    assert openscale_newtons(b"51588,0.8301,kg,24.75,\r\n") == pytest.approx(0.8301 * 9.80665)
    assert openscale_newtons(b"51588,-0.0002,kg,\r\n") == pytest.approx(-0.0002 * 9.80665)


@pytest.mark.parametrize(
    ("newtons", "line", "reason"),
    [
        (hx711_newtons, b"1.2345\n", "half line"),
        (hx711_newtons, b"1.2345", "half line"),
        (hx711_newtons, b".2345\r\n", "form"),
        (hx711_newtons, b"1.23451.2345\r\n", "form"),
        (hx711_newtons, b"1.234\r\n", "form"),
        (hx711_newtons, b"01.2345\r\n", "form"),
        (hx711_newtons, b"nan\r\n", "form"),
        (hx711_newtons, b"1e3\r\n", "form"),
        (hx711_newtons, b" 1.2345\r\n", "form"),
        (hx711_newtons, b"\xb1.2345\r\n", "form"),
        (hx711_newtons, b"999.0000\r\n", "range"),
        (openscale_newtons, b"51588,0.8300,lbs,24.75,\r\n", "unit"),
        (openscale_newtons, b"51588,0.83,kg,24.75,\r\n", "resolution"),
        (openscale_newtons, b"51588,0.8301,kg\r\n", "form"),
        (openscale_newtons, b"51588,0.8301,kg,\n", "half line"),
        (openscale_newtons, b"0.8301,kg,\r\n", "form"),
        (openscale_newtons, b"51588,99.0000,kg,\r\n", "range"),
    ],
)
def test_lines_that_are_no_force(newtons, line, reason):
    assert newtons(line).reason == reason
