"""Snakemake's report of a finished run: what it opens on, and what it holds."""

import base64
import json
import re
from html import unescape
from urllib.parse import unquote

import pytest

from headless import WIDER, headless, opened

pytestmark = pytest.mark.xdist_group("finished")

TWIN = "results/diagnosis/simulated-twin"
OF_SNAKEMAKE = "cdn.tailwindcss.com should not be used in production"  # it warns of its own styles


@pytest.fixture(scope="module")
def file(finished, tmp_path_factory):
    """The report of the whole run."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    made = finished.snakemake("--report", str(path))
    assert made.returncode == 0, made.stderr
    return path


@pytest.fixture(scope="module")
def report(file):
    """The landing page as HTML, and the results by category and by path."""
    text = file.read_text(encoding="utf-8")
    names = ("workflow_desc", "categories", "results")
    held = (re.findall(rf"^    var {name} = (.*);$", text, re.MULTILINE) for name in names)
    return [json.loads(one) for (one,) in held]


def test_it_opens_on_the_answers(report, finished):
    landing = report[0]
    heads = re.findall(r"<h1>(.*?)</h1>", landing)
    assert heads == ["Table I", "A concealed case", "Diagnoses", "All results"]
    table = (finished.folder / "results/tables/table_1.md").read_text(encoding="utf-8")
    model, mean = re.search(r"^\| (mlp) \| (-?[\d.]+)", table, re.MULTILINE).groups()
    assert f"<td>{model}</td><td>{mean}</td>" in landing
    said = json.loads((finished.folder / TWIN / "diagnosis.json").read_text(encoding="utf-8"))
    text = unescape(re.sub(r"</?span[^>]*>", "", landing))
    assert f"1. {said['effects'][0]['sentence']}" in text
    assert landing.count("<svg ") == landing.count("</svg>") == 1


def test_its_links_lead_to_results_and_categories(report):
    landing, categories, results = report
    links = [unquote(link) for link in re.findall(r'href="javascript:(.*?)"', landing)]
    shown = {re.fullmatch(r"app\.showResultInfo\('(.*)'\)", unescape(link)) for link in links}
    assert {one[1] for one in shown if one} >= {"results/tables/table_1.md", f"{TWIN}/report.html"}
    assert {one[1] for one in shown if one} <= set(results)
    opened = {re.fullmatch(r"app\.showCategory\('(.*)'\)", unescape(link)) for link in links}
    assert {one[1] for one in opened if one} == set(categories)


def test_a_figure_is_in_it_once_and_categories_are_in_the_reader_s_order(report):
    _, categories, results = report
    assert sorted(categories) == ["1 Paper", "2 Concealed effects", "3 Diagnosis"]
    assert {path.rpartition(".")[2] for path in results} == {"svg", "csv", "md", "html"}
    figures = [path for path in results if path.endswith(".svg")]
    assert len(figures) == 9 + 5 + 1  # of a diagnosis, of the score, one case
    assert not {path.replace(".svg", ".csv") for path in figures} & set(results)
    held = results[figures[0]]["data_uri"].partition("base64,")[2]
    assert b"<svg " in base64.b64decode(held)


def test_a_browser_shows_the_answer_first_and_whole_without_a_network(file):
    with headless() as started, opened(started, file) as shown:
        table = shown.page.get_by_role("heading", name="Table I", exact=True)
        for width in (360, 800, 1400):
            shown.page.set_viewport_size({"width": width, "height": 800})
            table.wait_for()
            assert shown.page.evaluate(WIDER) <= 0, width
            assert table.bounding_box()["x"] >= 0, width
            if width > 360:  # there Snakemake's own menu lies over the page until it is closed
                assert 0 < table.bounding_box()["y"] < 800, width
        assert shown.asked == []
        assert [said for said in shown.said if OF_SNAKEMAKE not in said] == []
