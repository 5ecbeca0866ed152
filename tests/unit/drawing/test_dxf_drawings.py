"""Skins out of DXF drawings."""

import math

import ezdxf
import pytest

from eitskin.drawing import source
from eitskin.errors import InputError
from eitskin.physics.outline import laid_out

MARKED = {"layer": "Electrodes"}
INCH, MM = 1, 4


@pytest.fixture
def drawn(tmp_path):
    """The skin of a DXF drawing that a function fills."""

    def read(fill, unit=MM, unit_mm=None):
        document = ezdxf.new()
        document.header["$INSUNITS"] = unit
        fill(document.modelspace())
        document.saveas(tmp_path / "a.dxf")
        return source.drawing(tmp_path / "a.dxf", unit_mm, False, None)

    return read


def test_a_polyline_in_inches(drawn):
    def fill(model):
        model.add_lwpolyline([(0, 0), (4, 0), (4, 2), (0, 2)], close=True)
        model.add_circle((1, 0), 0.1, dxfattribs=MARKED)

    block = drawn(fill, INCH).block
    assert block["outline"] == {"shape": "rectangle", "width_mm": 101.6, "height_mm": 50.8}
    assert block["electrode_xy_mm"] == [[-25.4, -25.4]]


def test_lines_and_arcs_that_meet_are_a_smooth_rim(drawn):
    def fill(model):
        model.add_line((100, 0), (0, 0))
        model.add_arc((100, 25), 25, -90, 90)
        model.add_line((100, 50), (0, 50))
        model.add_arc((0, 25), 25, 90, 270)
        for start, end in (((18, 48), (22, 48)), ((22, 48), (22, 52)), ((18, 48), (22, 52))):
            model.add_line(start, end, dxfattribs=MARKED)
        model.add_point((50, 0), dxfattribs=MARKED)
        model.add_line((80, -1), (80, 1), dxfattribs=MARKED)
        model.add_text("a title")

    seen = drawn(fill)
    rim = laid_out(seen.skin).outline
    assert rim.smooth and rim.perimeter_mm == pytest.approx(200 + 50 * math.pi, rel=1e-3)
    assert rim.area_mm2 == pytest.approx(5000 + 625 * math.pi, rel=1e-3)
    places = [pytest.approx(place, abs=0.05) for place in ((-30, 25), (0, -25), (30, -25))]
    assert seen.block["electrode_xy_mm"] == places


def test_a_circle_with_blocks_for_electrodes_is_a_disc(drawn):
    def fill(model):
        model.add_circle((5, 5), 30)
        model.doc.blocks.new("pad").add_circle((0, 0), 1)
        for k in range(8):
            place = (5 + 30 * math.cos(k * math.pi / 4), 5 + 30 * math.sin(k * math.pi / 4))
            model.add_blockref("pad", place, dxfattribs=MARKED)

    block = drawn(fill).block
    assert block["radius_mm"] == 30.0
    assert block["electrode_deg"] == [45.0 * k for k in range(8)]


def test_an_ellipse_without_unit(drawn):
    def fill(model):
        model.add_ellipse((5, 5), (40, 0), 0.5)
        model.add_circle((45, 5), 2, dxfattribs=MARKED)

    assert drawn(fill, 0, 2.0).block["outline"]["width_mm"] == 160.0
    with pytest.raises(InputError, match="unit: found none in the file"):
        drawn(fill, 0)


def test_a_spline_and_a_bulge(drawn):
    def spline(model):
        angles = [k * math.pi / 20 for k in range(40)]
        radii = [40 * (1 + 0.2 * math.cos(3 * angle)) for angle in angles]
        points = [(r * math.cos(a), r * math.sin(a)) for r, a in zip(radii, angles, strict=True)]
        model.add_spline(fit_points=[*points, points[0]])
        model.add_circle(points[0], 2, dxfattribs=MARKED)

    outline = laid_out(drawn(spline).skin).outline
    assert outline.smooth and outline.area_mm2 == pytest.approx(1632 * math.pi, rel=5e-3)

    def bulge(model):
        model.add_lwpolyline([(0, 0, 1), (0, 40, 0)], format="xyb", close=True)
        model.add_circle((0, 20), 2, dxfattribs=MARKED)

    seen = drawn(bulge)
    assert laid_out(seen.skin).outline.area_mm2 == pytest.approx(200 * math.pi, rel=1e-2)


def test_layers_that_are_off_are_not_read(drawn):
    def fill(model):
        model.add_lwpolyline([(0, 0), (4, 0), (4, 2), (0, 2)], close=True)
        model.add_circle((1, 0), 0.1, dxfattribs=MARKED)
        model.doc.layers.add("notes").off()
        model.add_circle((1, 1), 3, dxfattribs={"layer": "notes"})

    assert drawn(fill).block["outline"]["shape"] == "rectangle"


def test_an_open_polyline_is_one_message(drawn):
    def fill(model):
        model.add_lwpolyline([(0, 0), (40, 0), (40, 20), (0, 20)])

    with pytest.raises(InputError, match=r"LWPOLYLINE .*, layer '0': found an open path, 20 mm"):
        drawn(fill)


@pytest.mark.parametrize("content", [b"hello\nworld\n", b"\x00\xff\xfe" * 50, b""])
def test_no_dxf_is_one_message(tmp_path, content):
    file = tmp_path / "a.dxf"
    file.write_bytes(content)
    with pytest.raises(InputError, match="expected a DXF drawing"):
        source.drawing(file, None, False, None)
