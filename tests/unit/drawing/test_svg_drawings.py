"""Skins out of SVG drawings, and one message for each that shows none."""

import math

import numpy as np
import pytest

from eitskin.data import stated
from eitskin.drawing import source
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.physics.outline import laid_out
from eitskin.physics.rim_curve import RimCurve
from eitskin.physics.skin import Skin

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" {} viewBox="0 0 100 100">'
IN_MM = HEAD.format('width="100mm" height="100mm"')
SQUARE = '<path id="a" d="M10 10H90V90H10Z"/>'
TWO = '<g id="electrodes"><circle cx="10" cy="30" r="2"/><circle cx="90" cy="30" r="2"/></g>'


@pytest.fixture
def drawn(tmp_path):
    """The skin of the SVG drawing with the given content."""

    def read(content, head=IN_MM, unit_mm=None, mirrored=False, drive=None):
        file = tmp_path / "a.svg"
        file.write_text(f"{head}{content}</svg>", encoding="utf-8")
        return source.drawing(file, unit_mm, mirrored, drive)

    return read


def test_a_rectangle_is_seen_as_drawn_y_up_and_counter_clockwise(drawn):
    pad = '<rect x="69" y="29" width="2" height="2"/>'
    electrodes = f'<g class="x electrodes"><circle cx="20" cy="70" r="1"/>{pad}</g>'
    block = drawn('<rect x="10" y="30" width="60" height="40"/>' + electrodes).block
    assert block["outline"] == {"shape": "rectangle", "width_mm": 60.0, "height_mm": 40.0}
    assert block["electrode_xy_mm"] == [[-20.0, -20.0], [30.0, 20.0]]
    assert block["radius_mm"] is None and block["electrode_deg"] is None


@pytest.mark.parametrize("clockwise", [False, True])
def test_an_l_of_a_polygon_in_either_direction(drawn, clockwise):
    corners = [(0, 0), (0, 90), (60, 90), (60, 60), (30, 60), (30, 0)]
    points = " ".join(f"{x},{y}" for x, y in (corners[::-1] if clockwise else corners))
    seen = drawn(f'<polygon points="{points}"/><circle class="electrode" cx="45" cy="60" r="1"/>')
    assert laid_out(seen.skin).radius_mm == pytest.approx(300 / (2 * math.pi))
    drawn_corners = {(x - 30.0, 45.0 - y) for x, y in corners}
    assert {tuple(corner) for corner in seen.block["outline"]["corners_mm"]} == drawn_corners
    assert seen.block["electrode_xy_mm"] == [[15.0, -15.0]]


def circle(count):
    """Electrodes evenly round (50, 50), counter-clockwise as seen, from the right."""
    angles = [2 * math.pi * k / count for k in range(count)]
    places = [(50 + 40 * math.cos(angle), 50 - 40 * math.sin(angle)) for angle in angles]
    return "".join(f'<circle class="electrode" cx="{x}" cy="{y}" r="2"/>' for x, y in places)


@pytest.mark.parametrize(
    "rim",
    [
        '<circle cx="50" cy="50" r="40"/>',
        '<path d="M90 50A40 40 0 0 1 10 50A40 40 0 0 1 90 50"/>',
        '<circle cx="25" cy="5" r="20" transform="translate(0,40) scale(2)"/>',
    ],
)
def test_a_circle_is_a_disc(drawn, rim):
    block = drawn(circle(16) + rim).block
    assert block["radius_mm"] == pytest.approx(40.0, abs=1e-3)
    assert block["electrode_deg"] == pytest.approx([22.5 * k for k in range(16)], abs=1e-3)
    assert "outline" not in block


def test_mirrored_is_the_other_side(drawn):
    block = drawn(circle(8) + '<circle cx="50" cy="50" r="40"/>', mirrored=True).block
    assert block["electrode_deg"][:3] == pytest.approx([180.0, 135.0, 90.0])


def test_an_ellipse_and_a_turned_one(drawn):
    marks = '<circle class="electrode" cx="{}" cy="50" r="2"/>'
    block = drawn('<ellipse cx="50" cy="50" rx="45" ry="20"/>' + marks.format(95)).block
    assert block["outline"] == {"shape": "ellipse", "width_mm": 90.0, "height_mm": 40.0}
    turned = '<ellipse cx="50" cy="50" rx="40" ry="20" transform="rotate(30 50 50)"/>'
    seen = drawn(turned + '<g id="electrodes"><circle cx="84.6" cy="70" r="2"/></g>')
    assert seen.block["outline"]["smooth"] is True
    assert laid_out(seen.skin).outline.area_mm2 == pytest.approx(math.pi * 800, rel=1e-4)


def test_a_turned_rectangle_has_its_corners(drawn):
    turned = '<rect x="30" y="30" width="40" height="40" transform="rotate(45 50 50)"/>'
    seen = drawn(turned + '<circle class="electrode" cx="60" cy="32" r="1"/>')
    reach = pytest.approx(math.hypot(20, 20), abs=1e-3)
    assert max(max(corner) for corner in seen.block["outline"]["corners_mm"]) == reach


def test_a_bent_rim_is_followed_and_a_sentence_says_its_corners(drawn):
    bent = '<path d="M20 10A40 40 0 0 1 20 90Z"/>'
    seen = drawn(bent + '<g id="electrodes"><circle cx="20" cy="50" r="2"/></g>')
    rim = RimCurve(tuple(map(tuple, seen.block["outline"]["corners_mm"])), smooth=True)
    assert seen.block["outline"]["smooth"] and len(rim.corner_points) == 2
    assert rim.area_mm2 == pytest.approx(800.0 * math.pi, rel=2e-4)
    said = "It is bent, with corners at (-20, 40) and (-20, -40) mm about the origin"
    assert any(sentence.startswith(said) for sentence in seen.sentences)


WHEEL = "".join(
    f"L{50 + r * math.cos(a):.3f} {50 + r * math.sin(a):.3f}"
    for k in range(35)
    for r, a in ((40, 2 * math.pi * k / 35), (36, 2 * math.pi * (k + 0.5) / 35))
)


def test_a_rim_of_too_many_corners_is_a_polygon_and_a_sentence_says_so(drawn):
    seen = drawn(f'<path d="M{WHEEL[1:]}Z"/><g id="electrodes"><circle cx="90" cy="50" r="2"/></g>')
    assert len(seen.block["outline"]["corners_mm"]) <= 64 and "smooth" not in seen.block["outline"]
    assert any(sentence.startswith("No curve follows it") for sentence in seen.sentences)


def test_electrodes_stand_on_a_bent_rim(drawn):
    angles = np.radians(np.arange(-75, 76, 15))
    marks = [
        f'<circle cx="{20 + 40 * np.cos(a)}" cy="{50 + 40 * np.sin(a)}" r="2"/>' for a in angles
    ]
    bent = '<path d="M20 10A40 40 0 0 1 20 90Z"/><g id="electrodes">'
    seen = drawn(bent + "".join(marks) + "</g>")
    rest = {"thickness_mm": 2.0, "conductivity_S_per_m": 1.0, "electrode_width_mm": 2.0}
    rest["contact_impedivity_ohm_m2"] = 1e-3
    geometry = Geometry.from_skin(
        Skin.from_metadata(dict.fromkeys(stated.SKIN) | seen.block | rest)
    )
    assert len(geometry.electrode_deg) == 11
    assert not any("At a corner" in sentence for sentence in seen.sentences)


def test_an_electrode_at_a_corner_is_said(drawn):
    seen = drawn(SQUARE + '<g id="electrodes"><circle cx="10" cy="10" r="2"/></g>')
    said = "At a corner, where they need a width to be simulated: electrodes 0."
    assert said in seen.sentences


def test_parts_that_meet_are_one_rim(drawn):
    sides = ["M10 10H90", "M90 90V10", "M90 90H10", "M10 90V10"]
    paths = "".join(f'<path d="{side}"/>' for side in sides)
    assert drawn(paths + TWO).block["outline"]["width_mm"] == 80.0


@pytest.mark.parametrize(
    ("size", "unit_mm", "width"),
    [
        ('width="10cm" height="10cm"', None, 80.0),
        ('width="2in" height="4in"', None, 80.0 * 50.8 / 100),
        ("", 0.2646, 80.0 * 0.2646),
        ('width="500" height="500"', 1.0, 80.0),
        ('width="10cm" height="10cm"', 2.0, 160.0),
    ],
)
def test_units_of_the_file_or_the_option(drawn, size, unit_mm, width):
    block = drawn(SQUARE + TWO, HEAD.format(size), unit_mm).block
    assert block["outline"]["width_mm"] == pytest.approx(width, abs=1e-4)


def test_without_a_view_box_a_unit_is_a_pixel_of_css(drawn):
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="50mm">'
    block = drawn(SQUARE + TWO, head).block
    assert block["outline"]["width_mm"] == pytest.approx(80 * 25.4 / 96, abs=1e-4)


def test_names_tell_the_rim_and_the_electrodes_among_other_shapes(drawn):
    head = IN_MM.replace(
        " viewBox", ' xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape" viewBox'
    )
    marks = TWO.replace('id="electrodes"', 'id="layer2" inkscape:label="Electrodes"')
    frame = '<rect width="100" height="100"/><circle cx="50" cy="50" r="3"/>'
    seen = drawn(frame + SQUARE.replace('id="a"', 'id="Rim"') + marks, head)
    assert seen.n_electrodes == 2 and seen.block["outline"]["width_mm"] == 80.0
    assert "2 other shapes are left out" in " ".join(seen.sentences)


def test_drives_of_a_pattern(drawn):
    seen = drawn(circle(8) + '<circle cx="50" cy="50" r="40"/>', drive="skip-1")
    assert seen.drives[[0, 7]].tolist() == [[0, 2], [7, 1]]


def test_what_is_printed_can_be_simulated(drawn):
    block = drawn(SQUARE + TWO).block
    rest = {"thickness_mm": 2.0, "conductivity_S_per_m": 1.0, "electrode_width_mm": 0.0}
    stated.refuse(block | rest)
    skin = Skin.from_metadata(dict.fromkeys(stated.SKIN) | block | rest)
    geometry = Geometry.from_skin(skin)
    places = geometry.rim(np.radians(geometry.electrode_deg))
    assert places == pytest.approx(np.array([-40 + 20j, 40 + 20j]), abs=1e-3)


BAD = {
    "open": (
        '<path id="u" d="M10 10H90V90H10"/>' + TWO,
        r"path 'u': found an open path, 80 mm between its ends \(10, -10\) and \(10, -90\) mm",
    ),
    "crossing": (
        '<polygon id="x" points="10,10 90,90 90,10 10,80"/>' + TWO,
        "polygon 'x': found a path that crosses itself: sides 0 and 2",
    ),
    "nothing": ("", "shapes: found none, expected a closed path"),
    "no rim": (TWO, "rim: found electrodes alone, expected one closed path"),
    "several": (
        SQUARE + '<rect x="20" y="20" width="40" height="40"/>' + TWO,
        "rim: found 2 closed paths: path 'a', 80 x 80 mm, shape 2, a rect, 40 x 40 mm",
    ),
    "no electrodes": (SQUARE, "electrodes: found none, expected small closed shapes"),
    "far": (
        SQUARE + '<circle id="e" class="electrode" cx="20" cy="50" r="2"/>',
        r"circle 'e': found electrode 0 10 mm off the rim, at \(-30, 0\) mm",
    ),
    "together": (
        SQUARE + TWO.replace('cx="90"', 'cx="10"'),
        "shape 3, a circle: found electrodes 0 and 1 at one place",
    ),
    "a number": ('<circle cx="a" r="2"/>', "circle, cx: found 'a', expected a number"),
    "a share": ('<rect width="100%" height="3"/>', "rect, width: found '100%', expected a number"),
    "a path": ('<path id="p" d="M10 10 L x"/>', "path 'p', d: found .*, expected the data of a"),
    "XML": (SQUARE + "<g>", "line 1, column .*: found mismatched tag, expected XML"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_drawing_is_one_message(drawn, name):
    content, message = BAD[name]
    with pytest.raises(InputError, match=message) as refusal:
        drawn(content)
    assert refusal.value.file.name == "a.svg"


def test_no_unit_is_one_message(drawn):
    with pytest.raises(InputError, match="unit: found none in the file, expected --unit mm"):
        drawn(SQUARE + TWO, HEAD.format('width="100" height="100"'))


def test_another_root_is_one_message(tmp_path):
    file = tmp_path / "a.svg"
    file.write_text("<html/>", encoding="utf-8")
    with pytest.raises(InputError, match="line 1: found <html>, expected <svg>"):
        source.drawing(file, None, False, None)
