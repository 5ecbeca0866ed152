"""The report and the page of a comparison in a real browser: offline, silent, whole at every width,
on paper and without colours. Skipped where Chromium is not installed."""

import json

import numpy as np
import pytest

from diagnosed_skin import SCHEMA, diagnosed, with_every_effect, with_rig
from eitskin.diagnose.report import comparison_page, page
from eitskin.effects.effect import SITES
from headless import CUT, OUTSIDE, PALE, WIDER, headless, opened

PAGES = ("full", "unexplained", "untouched", "compared")
WIDTHS = (360, 800, 1400)
PAPER = 680  # px: A4 between margins of 15 mm
LEAST = 4.5  # contrast of text that everyone reads: WCAG 2, AA


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The files by name of PAGES."""
    found = {}
    for name in ("unexplained", "untouched", "full"):
        kind = "partly-explained" if name == "full" else name
        folder, recording = diagnosed(tmp_path_factory.mktemp(name), kind)
        if name == "full":
            with_every_effect(folder)
            with_many_gains(folder / "diagnosis.json")
            with_rig(folder)
        page.write(folder, recording, SCHEMA, folder / "report.html")
        found[name] = folder / "report.html"
    found["compared"] = found["full"].with_name("comparison.html")
    comparison_page.write(comparison(), found["compared"])
    return found


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
    """What comparison.json may say: a value that changed and many that did not, of long names."""
    parts = ["monday-morning-before-the-gel-was-cast", "friday"]

    def row(k, changed):
        ends = {"value": 1.2, "low": 1.1, "high": 1.3, "unit": "1"}
        p = 1e-9 if changed else 0.5
        return {
            "name": "force-dependent-impedance",
            "calibration": False,
            "parameters": ["ratio_per_N"],
            **{kind: [k] if kind == "electrodes" else [] for kind in SITES},
            **{"chi2": 40.1, "dof": 1, "p": p, "q": p, "changed": changed},
            "parts": {part: {"ratio_per_N": ends} for part in parts},
            "runs": [{"parts": [one], "values": {"ratio_per_N": ends}} for one in parts]
            if changed
            else [{"parts": parts, "values": {"ratio_per_N": ends}}],
            "sentence": f"The contact impedance of electrode {k} is what it was (1.2).",
        }

    held = {"frames": 12, "chi2_per_dof_as_found": 1.02, "chi2_per_dof_all_shared": 8.1}
    held |= {"elpd_gain": 411.0, "elpd_se": 12.0}
    tested = [row(k, k == 3) for k in range(16)]
    return {"parts": parts, "tested": tested, "held_out": held, "p_value": 1e-9}


@pytest.fixture(scope="module")
def chromium():
    with headless() as started:
        yield started


@pytest.mark.parametrize("name", PAGES)
def test_it_is_whole_at_every_width(chromium, pages, name):
    with opened(chromium, pages[name]) as shown:
        for width in WIDTHS:
            shown.set_viewport_size({"width": width, "height": 800})
            assert shown.evaluate(WIDER) <= 0, width
            assert shown.evaluate(OUTSIDE) == [], width


@pytest.mark.parametrize("name", PAGES)
def test_it_prints_whole(chromium, pages, name):
    with opened(chromium, pages[name], viewport={"width": PAPER, "height": 1000}) as shown:
        shown.emulate_media(media="print")
        assert shown.evaluate(WIDER) <= 0
        assert shown.evaluate(OUTSIDE) == []
        assert shown.evaluate(CUT) == []
        assert shown.pdf(format="A4").startswith(b"%PDF")


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize(
    "eyes", [{"color_scheme": "dark"}, {"color_scheme": "light"}, {"contrast": "more"}], ids=str
)
def test_its_text_is_dark_on_a_light_ground(chromium, pages, name, eyes):
    with opened(chromium, pages[name]) as shown:
        shown.emulate_media(**eyes)
        assert shown.evaluate(PALE, LEAST) == []


@pytest.mark.parametrize("name", PAGES)
def test_it_can_be_read_out(chromium, pages, name):
    """Without scripts; one title, headings in order, every picture with words."""
    with opened(chromium, pages[name], java_script_enabled=False) as shown:
        assert shown.locator("script").count() == 0
        assert shown.locator("h1").count() == 1
        levels = [int(tag[1]) for tag in tags(shown)]
        assert all(after <= before + 1 for before, after in zip(levels, levels[1:], strict=False))
        words = [one.get_attribute("aria-label") for one in shown.locator("svg").all()]
        words += [one.get_attribute("alt") for one in shown.locator("img").all()]
        assert words or name == "untouched"
        assert all(words)


def tags(shown):
    return shown.locator("h1, h2, h3, h4").evaluate_all("all => all.map(one => one.tagName)")
