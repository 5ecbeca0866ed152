import numpy as np
import pandas as pd
import pytest

from eitskin.data.recording import Recording, frames_table, metadata_of, presses
from eitskin.errors import InputError
from eitskin.paper import figure_1
from eitskin.physics.protocol import channel_table
from eitskin.physics.skin import Skin
from eitskin.simulate.readings import simulate

SHARES = ((np.arange(12) + 0.4) / 12).tolist()


def test_the_press_shown_is_nearest_to_half_the_radius_and_its_frames_rise(make_recording):
    recorded = make_recording(presses=20)
    shown = figure_1.press(recorded, "bench")
    frames = recorded.frames[recorded.frames["touch"]]
    radius_deviation = (np.hypot(frames["x_mm"], frames["y_mm"]) / 80.0 - 0.5).abs()
    assert abs(abs(shown.place) / 80.0 - 0.5) == pytest.approx(radius_deviation.min())
    rows = recorded.frames.set_index("frame").loc[shown.frame]
    assert rows["touch"].all()
    assert rows["x_mm"].to_numpy() == pytest.approx(shown.place.real)
    assert shown.force_N.tolist() == rows["force_N"].tolist()


@pytest.mark.parametrize("magnitude", [False, True])
def test_both_images_light_up_at_the_touch_and_tell_the_rise(make_recording, magnitude):
    recorded = make_recording(presses=20)
    if magnitude:
        recorded.voltage = np.abs(recorded.voltage)
        recorded.metadata["voltage"] = "magnitude"
    shown = figure_1.press(recorded, "bench")
    strongest = np.nanargmax(shown.force_N)
    for image, reach in ((shown.noser, 10.0), (shown.projected, 5.0)):
        place = shown.places[image[strongest].argmax()] * 80.0
        assert abs(place - shown.place) < reach
    area = (2.0 / figure_1.ACROSS) ** 2
    ratio = shown.noser[strongest].sum() * area / (0.01 * shown.force_N[strongest])
    assert 0.3 < ratio < 3.0, "the conductance added, to a factor"
    assert np.abs(shown.projected).max() == 1.0


def test_the_level_of_the_readings_does_not_matter(make_recording):
    recorded = make_recording(presses=10)
    press_at_level = figure_1.press(recorded, "bench")
    recorded.voltage = 1e3 * recorded.voltage
    recorded.metadata["unit"] = "arbitrary"
    after = figure_1.press(recorded, "bench")
    np.testing.assert_allclose(after.noser, press_at_level.noser, rtol=1e-6, atol=1e-9)


def test_lost_channels_leave_an_image(make_recording):
    recorded = make_recording(presses=10)
    recorded.voltage[:, 7] = np.nan
    shown = figure_1.press(recorded, "bench")
    assert np.isnan(shown.change[:, 7]).all() and np.isfinite(shown.noser).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r.metadata["skin"].update(radius_mm=None), "skin.radius_mm: found null"),
        (lambda r: r.metadata["skin"].update(electrode_deg=None), "electrode_deg: found null"),
        (lambda r: r.metadata.update(values="difference"), "found differences"),
        (lambda r: setattr(r, "voltage", None), "found a query"),
        (lambda r: r.frames.__setitem__("touch", False), "found no touch"),
    ],
)
def test_what_cannot_be_drawn_is_refused(make_recording, change, message):
    recorded = make_recording(presses=3)
    change(recorded)
    with pytest.raises(InputError, match=message):
        figure_1.press(recorded, "bench")


def test_every_electrode_is_drawn_whole(make_recording):
    figure = figure_1.draw(figure_1.press(make_recording(presses=3), "bench"))
    figure.canvas.draw()
    for axes in figure.axes:
        for line in [line for line in axes.lines if line.get_marker() == "s"]:
            half = 0.5 * line.get_markersize() / 72 * figure.dpi
            pixels = line.get_transform().transform(line.get_xydata())
            box = axes.get_window_extent()
            assert (pixels >= [box.x0 + half, box.y0 + half]).all()
            assert (pixels <= [box.x1 - half, box.y1 - half]).all()


def test_files_are_the_same_for_the_same_recording(make_recording, tmp_path):
    recorded = make_recording(presses=3)
    file_bytes = []
    for k in range(2):
        files = [tmp_path / f"{k}.{kind}" for kind in ("svg", "png", "csv")]
        figure_1.write(recorded, "bench", *files)
        file_bytes.append([file.read_bytes() for file in files])
    assert file_bytes[0] == file_bytes[1]
    table = pd.read_csv(tmp_path / "0.csv")
    counts = table["panel"].value_counts()
    assert counts["untouched frame"] == 208 and counts["change"] == 208 * 4
    assert counts["noser"] == counts["back-projection"] > 1000 * 4
    assert set(table["unit"]) == {"V", "1"}


def test_a_press_on_an_outline_lights_up_at_its_place(tmp_path):
    recorded = outlined_recording()
    shown = figure_1.press(recorded, "bench")
    strongest = np.nanargmax(shown.force_N)
    place_mm = 60.0 * shown.places  # half of the width, about the middle
    assert (np.abs(place_mm.real) < 60.0).all() and (np.abs(place_mm.imag) < 35.0).all()
    for image in (shown.noser, shown.projected):
        assert abs(place_mm[image[strongest].argmax()] - shown.place) < 8.0
    files = [tmp_path / f"1.{kind}" for kind in ("svg", "png", "csv")]
    figure_1.write(recorded, "bench", *files)
    table = pd.read_csv(files[2])
    assert table["x_mm"].abs().max() > 50.0 > 35.0 > table["y_mm"].abs().max()


def outlined_recording():
    """Three presses on a rectangle with electrodes that are points."""
    outline = {"shape": "rectangle", "width_mm": 120.0, "height_mm": 70.0}
    stated = dict.fromkeys(("radius_mm", "electrode_deg"))
    stated |= {"thickness_mm": 3.0, "conductivity_S_per_m": 0.5, "electrode_width_mm": 0.0}
    stated |= {"contact_impedivity_ohm_m2": 0.0, "current_A": 1e-3, "contrast_per_N": 0.2}
    skin = Skin.from_metadata({**stated, "outline": outline, "electrode_s": SHARES})
    x_mm = np.repeat([-30.0, 0.0, 30.0], 5)
    touch = np.tile([False, True, True, True, True], 3)
    force_N = np.tile([0.0, 1.0, 2.0, 3.0, 4.0], 3)
    frames = frames_table(0.5 * np.arange(15), touch, x_mm, 12.0, force_N, 10.0)
    channels = channel_table(12)
    metadata = metadata_of(channels, skin.metadata(), "simulation", "signed", frame_s=0.1)
    recorded = Recording(frames, None, None, None, metadata)
    recorded.voltage = simulate(frames, presses(recorded), skin, channels, [], "train")
    recorded.voltage += 1e-7 * np.random.default_rng(1).standard_normal(recorded.voltage.shape)
    return recorded
