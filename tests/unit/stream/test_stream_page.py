"""The page of `eitskin stream --view`: what it serves, and what a browser makes of it."""

import http.client
import io
import json
import re
import threading
import time

import numpy as np
import pytest

import streamed_skin as skin
from eitskin import cli
from eitskin.errors import InputError
from eitskin.exported import file
from eitskin.exported.predictor import Estimate
from eitskin.stream import page
from eitskin.stream.frames import Frame, Trouble
from eitskin.stream.judge import CANNOT_TELL, NO_TOUCH, TOUCH, Verdict
from eitskin.stream.page import PageView
from eitskin.stream.view import View
from headless import OUTSIDE, PALE, WIDER, headless
from manual import browser

TARGETS = ["x", "y", "F"]
STATED = {"radius_mm": 80.0, "electrode_deg": None}
ESTIMATE = Estimate(np.array([20.0, -10.0, 6.0]), np.array([3.0, 4.0, 0.5]))
SIZES = ((1400, 900), (390, 844))
CONTRAST = 4.5


@pytest.fixture
def view():
    lines = View(TARGETS, stream=io.StringIO())
    shown = PageView(lines, TARGETS, skin.TABLE, STATED, "a <b> file.parquet")
    yield shown
    if not shown.ended.is_set():
        shown.close()


def at(view, path, host=None):
    """The answer to a request."""
    connection = http.client.HTTPConnection("127.0.0.1", view._server.server_port, timeout=20)
    connection.request("GET", path, headers={"Host": host} if host else {})
    return connection.getresponse()


def event(stream):
    """The next event of a stream."""
    while True:
        line = stream.readline().decode()
        if line.startswith("data: "):
            return json.loads(line.removeprefix("data: "))


def waited(opened, name, text):
    """Wait until an element of a page has a text in it."""
    told = "([name, text]) => document.getElementById(name).textContent.includes(text)"
    opened.wait_for_function(told, arg=[name, text])


def frame(time_s, kind=TOUCH, **fields):
    fields = {"estimate": ESTIMATE} | fields if kind == TOUCH else fields
    return Frame(time_s, time.perf_counter(), np.zeros(208)), Verdict(kind, **fields)


def test_the_skin_has_even_electrodes_where_the_model_does_not_say(view):
    told = json.loads(at(view, "/skin").read())
    assert told["radius_mm"] == 80.0 and told["source"] == "a <b> file.parquet"
    assert told["electrode_deg"] == [22.5 * k for k in range(16)]


def test_a_browser_that_comes_late_gets_what_was_and_then_what_comes_and_the_end(view):
    view.frame(*frame(0.0))
    view.trouble(Trouble(0.5, "the board repeats itself: 3 frames alike to the last digit"))
    stream = at(view, "/events")
    first, second = event(stream), event(stream)
    assert first["verdict"] == TOUCH and first["x_mm"] == {"value": 20.0, "low": 17.0, "high": 23.0}
    assert second["trouble"].startswith("the board repeats itself")
    view.frame(*frame(1.0, CANNOT_TELL, reason="unlike what"))
    assert event(stream)["why"] == "unlike what"
    closing = threading.Thread(target=view.close)
    closing.start()
    assert "event: end" in stream.read().decode()
    closing.join()
    assert not view._readers


def test_a_browser_that_does_not_read_delays_no_frame_and_loses_the_oldest(view, monkeypatch):
    reader = view.reader()
    for number in range(page.KEPT + page.WAITING + 50):
        view._publish({"time_s": number})
    assert reader.qsize() == page.KEPT + page.WAITING
    assert json.loads(reader.get().removeprefix("data: "))["time_s"] == 50
    view.leave(reader)


def test_nothing_else_is_served_nor_anybody_of_another_name(view):
    assert at(view, "/../cli.py").status == 404
    assert at(view, "/", host="evil.example").status == 403
    assert at(view, "/", host=f"localhost:{view._server.server_port}").status == 200


def test_the_page_loads_nothing_from_elsewhere():
    text = page.PAGE.read_text(encoding="utf-8")
    assert not [u for u in re.findall(r"https?://[^\"' ]+", text) if "w3.org/2000/svg" not in u]
    assert "default-src 'none'" in text and "innerHTML" not in text


def test_a_port_in_use_is_refused(view):
    port = view._server.server_port
    for number in (port, 70000, -1):
        with pytest.raises(InputError, match="expected a free port"):
            PageView(View(TARGETS, stream=io.StringIO()), TARGETS, skin.TABLE, None, "x", number)


def test_a_browser_that_disconnects_is_no_error_and_another_error_is(view, capsys):
    for error in (BrokenPipeError(), ConnectionResetError(), ValueError("other")):
        try:
            raise error
        except type(error):
            view._server.handle_error(None, ("127.0.0.1", 1))
    printed = capsys.readouterr().err
    assert "ValueError: other" in printed and "Pipe" not in printed and "Reset" not in printed


@pytest.mark.xdist_group("streamed")
def test_the_command_says_where_and_streams_a_recording_as_before(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    file.write(skin.exported(), "mlp.npz")
    states = np.array([[0.0, 0.0, 0.0]] * 12 + [[20.0, -10.0, 6.0]] * 3)
    skin.write_recording(tmp_path / "skin.parquet", states)
    words = ["stream", "skin.parquet", "--model", "mlp.npz", "--fast", "--json", "--view"]
    assert cli.main(words) == 0
    said = capsys.readouterr()
    assert re.search(r"view: http://127\.0\.0\.1:\d+/", said.err)
    assert len(said.out.splitlines()) == 15


@pytest.mark.parametrize("size", SIZES)
def test_a_browser_draws_the_touch_its_force_and_the_board_s_repeats(view, size):
    with headless() as started:
        context = started.new_context(viewport={"width": size[0], "height": size[1]})
        context.set_default_timeout(browser.PATIENCE_MS)
        opened, said, asked = context.new_page(), [], []
        opened.on("console", lambda message: said.append(message.text))
        opened.on("pageerror", lambda error: said.append(str(error)))
        opened.on("request", lambda request: asked.append(request.url))
        for k in range(30):
            view.frame(*frame(0.1 * k, NO_TOUCH if k < 10 else TOUCH))
        opened.goto(view.address)
        waited(opened, "verdict", "touch")
        assert opened.inner_text("#place") == "20.0 ± 3.0, -10.0 ± 4.0 mm"
        assert opened.inner_text("#force") == "6.00 ± 0.50 N"
        assert "frames a second" in opened.inner_text("#rate")
        assert "ms after the frame" in opened.inner_text("#late")
        assert opened.get_attribute("#uncertainty", "rx") == "0.0375"
        assert opened.get_attribute("#line", "d").count("L") == 19
        assert opened.inner_text("h1").endswith("of a <b> file.parquet")
        box = opened.query_selector("#verdict").bounding_box()
        assert box["y"] + box["height"] <= size[1]
        if size == SIZES[0]:
            assert opened.evaluate("() => document.documentElement.scrollHeight") <= size[1]
        assert opened.evaluate(OUTSIDE) == [] and opened.evaluate(WIDER) <= 0
        assert opened.evaluate(PALE, CONTRAST) == []
        opened.keyboard.press("Tab")
        opened.keyboard.press("Enter")
        assert opened.get_attribute("#pause", "aria-pressed") == "true"
        for k in range(30, 150):
            view.frame(*frame(0.1 * k, CANNOT_TELL, notices=("a palm",) if k == 149 else ()))
        waited(opened, "news", "a palm")
        assert opened.inner_text("#verdict") == "touch"
        assert opened.evaluate("() => lastFrames.length") <= 101
        opened.keyboard.press("Enter")
        view.trouble(Trouble(15.1, "the board repeats itself: 3 frames alike to the last digit"))
        opened.wait_for_function(
            "() => document.getElementById('board').textContent.includes('repeats')"
        )
        view.frame(*frame(15.2, CANNOT_TELL, reason="a palm", lost_electrodes=(3,)))
        waited(opened, "lost", "3")
        assert opened.get_attribute("#touch", "visibility") == "hidden"
        assert opened.inner_text("#reason") == "a palm"
        threading.Thread(target=view.close).start()
        opened.wait_for_function(
            "() => document.getElementById('board').textContent.includes('ended')"
        )
        assert said == [] and {url.split("/")[2] for url in asked if url.startswith("http")} == {
            view.address.split("/")[2]
        }
        context.close()
