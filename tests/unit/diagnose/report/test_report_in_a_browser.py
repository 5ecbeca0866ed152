"""The report and the page of a comparison in a real browser: offline, silent, whole at every width,
on paper and without colours. Skipped where Chromium is not installed."""

import json
from itertools import pairwise

import numpy as np
import pytest

from diagnosed_skin import SCHEMA, diagnosed, with_every_effect, with_rig
from eitskin.diagnose.compare import page as comparison_page
from eitskin.diagnose.report import page
from headless import CUT, OUTSIDE, PALE, WIDER, headless, opened

PAGES = ("compared", "untouched", "full")
WIDTHS = (360, 800, 1400)
PAPER = 680  # px: A4 between margins of 15 mm
UNFOLDED = "() => document.querySelectorAll('details').forEach(each => each.open = true)"
ANSWER_END = "() => document.querySelector('main').getBoundingClientRect().bottom + scrollY"
LEAST = 4.5  # contrast of text that everyone reads: WCAG 2, AA


def written(name, folder):
    """The file of one of PAGES."""
    if name == "compared":
        comparison_page.write(comparison(), folder / "comparison.html")
        return folder / "comparison.html"
    folder, recording = diagnosed(folder, "partly-explained" if name == "full" else name)
    if name == "full":
        with_every_effect(folder)
        with_many_gains(folder / "diagnosis.json")
        with_rig(folder)
    page.write(folder, recording, SCHEMA, folder / "report.html")
    return folder / "report.html"


def with_many_gains(path):
    """Make the gains of a diagnosis those of 208 channels."""
    said = json.loads(path.read_text(encoding="utf-8"))
    effect = next(each for each in said["effects"] if each["name"] == "channel-gain")
    ends = {"value": 1.5, "low": 1.25, "high": 1.75}
    gain = {key: np.linspace(end, end + 0.1, 208).tolist() for key, end in ends.items()}
    effect |= {"scope": "dense", "channels": list(range(208))}
    effect["parameters"] = {"gain": gain | {"unit": "1"}}
    path.write_text(json.dumps(said), encoding="utf-8")


def comparison():
    """comparison.json of parts with long names: two faults, and what is said beside them."""
    parts = ["monday-morning-before-the-gel-was-cast", "friday"]
    faults = [
        f"In friday, what is driven from electrode {k} reads 4.99 % more (120 nats; next,"
        f" electrode-gain at electrode {k + 1}: 31)."
        for k in (3, 9)
    ]
    common = "All readings together moved by +1.2 %: the skin's or the current's."
    difference = {"found": [{"sentence": text} for text in faults], "lost_channels": [30]}
    difference |= {"untouched_frames": [40, 38], "threshold_nats": 26.0, "margin_nats": 10.0}
    return {"parts": parts, "sentences": [*faults, common], "difference": difference}


@pytest.fixture(scope="module")
def chromium():
    with headless() as started:
        yield started


@pytest.fixture(scope="module", params=PAGES)
def shown(request, chromium, tmp_path_factory):
    """Each of PAGES, opened once, all of it unfolded."""
    path = written(request.param, tmp_path_factory.mktemp(request.param))
    with opened(chromium, path) as document:
        document.page.evaluate(UNFOLDED)
        yield document


def test_it_is_whole_at_every_width(shown):
    for width in WIDTHS:
        shown.page.set_viewport_size({"width": width, "height": 800})
        assert shown.page.evaluate(WIDER) <= 0, width
        assert shown.page.evaluate(OUTSIDE) == [], width


def test_it_prints_whole(shown):
    shown.page.set_viewport_size({"width": PAPER, "height": 1000})
    shown.page.emulate_media(media="print")
    assert shown.page.evaluate(WIDER) <= 0
    assert shown.page.evaluate(OUTSIDE) == []
    assert shown.page.evaluate(CUT) == []
    assert shown.page.pdf(format="A4").startswith(b"%PDF")
    shown.page.emulate_media(media="screen")


@pytest.mark.parametrize(
    "eyes", [{"color_scheme": "dark"}, {"color_scheme": "light"}, {"contrast": "more"}], ids=str
)
def test_its_text_is_dark_on_a_light_ground(shown, eyes):
    shown.page.emulate_media(**eyes)
    assert shown.page.evaluate(PALE, LEAST) == []


def test_it_can_be_read_out(shown):
    """One title, headings in order, every picture with words."""
    heads = shown.page.locator("h1, h2, h3, h4, h5")
    levels = heads.evaluate_all("all => all.map(one => Number(one.tagName[1]))")
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    pictures = shown.page.locator("svg, img")
    read = "all => all.map(one => one.getAttribute('aria-label') || one.getAttribute('alt'))"
    words = pictures.evaluate_all(read)
    assert all(words) and (words or shown.page.url.endswith("comparison.html"))


def test_it_is_silent_without_scripts_and_asks_for_nothing(shown):
    assert shown.page.locator("script").count() == 0
    assert shown.asked == [] and shown.said == []


@pytest.fixture(scope="module", params=["explained", "unexplained", "candidate"])
def answered(request, chromium, tmp_path_factory):
    """Reports of three verdicts, folded as they open."""
    kind = "partly-explained" if request.param == "candidate" else request.param
    folder, recording = diagnosed(tmp_path_factory.mktemp(request.param), kind)
    if request.param == "candidate":
        with_rig(folder)
    page.write(folder, recording, SCHEMA, folder / "report.html")
    with opened(chromium, folder / "report.html") as document:
        yield document


def test_the_answer_is_on_the_first_screen_and_on_two_of_a_telephone(answered):
    for width, height, screens in ((1400, 900, 1), (390, 844, 2)):
        answered.page.set_viewport_size({"width": width, "height": height})
        assert answered.page.evaluate(WIDER) <= 0
        assert answered.page.evaluate(ANSWER_END) <= screens * height, width
    assert not answered.page.locator("#proof").get_attribute("open")
    assert answered.page.locator("#proof h2").first.is_hidden()
    assert answered.asked == [] and answered.said == []


def test_it_unfolds_by_keyboard_and_words_lead_to_the_glossary(answered):
    answered.page.set_viewport_size({"width": 1400, "height": 900})
    answered.page.locator("#proof > summary").focus()
    answered.page.keyboard.press("Enter")
    assert answered.page.locator("#proof h2").first.is_visible()
    word = answered.page.locator("#proof a.term").first
    assert word.get_attribute("title")
    word.focus()
    answered.page.keyboard.press("Enter")
    assert answered.page.locator(word.get_attribute("href")).is_visible()


def test_on_paper_the_answer_is_a_page_and_words_have_their_meaning(answered):
    answered.page.emulate_media(media="print")
    meaning = "one => getComputedStyle(one, '::after').content"
    word = answered.page.locator("main a.term").first
    assert word.evaluate(meaning) != "none"
    assert answered.page.evaluate(WIDER) <= 0
    answered.page.emulate_media(media="screen")
