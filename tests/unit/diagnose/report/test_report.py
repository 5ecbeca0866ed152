"""The report: whole, readable without anything else, the same bytes for the same inputs."""

import json
import re
from dataclasses import fields, replace
from functools import partial
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text

from diagnosed_skin import (
    CHANNELS,
    KINDS,
    RIG,
    SCHEMA,
    UNMET,
    diagnosed,
    with_every_effect,
    with_rig,
)
from eitskin import plotting
from eitskin.diagnose.report import figures, page
from eitskin.diagnose.report.answer import omitted_frames
from eitskin.diagnose.report.evidence import read
from eitskin.diagnose.search.journal import Decision
from eitskin.diagnose.verdict import refusals, rig_words
from eitskin.diagnose.verdict.conclusion import PART_KEYS
from eitskin.effects import EFFECTS, catalogue_names
from eitskin.errors import InputError
from eitskin.quantities import MINUS, NONE, number

VOID = {"meta", "br"}
RULES = Path(__file__).parents[4] / "workflow" / "rules" / "diagnose.smk"
TITLES = {"before": "s", "after": "o"}  # and the markers of their means
CAPTIONS = Path(__file__).parents[4] / "workflow" / "report"


class Page(HTMLParser):
    """A strict reader: every element closed in order, ids once; its text and attributes."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.attributes, self.texts = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.handle_startendtag(tag, attributes)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.attributes += [(tag, key, value) for key, value in attributes]
        self.ids += [value for key, value in attributes if key == "id"]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" not in self.open:
            self.texts.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", "".join(self.texts))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The folder of each kind, with its report."""
    found = {}
    for kind in KINDS:
        folder, recording = diagnosed(tmp_path_factory.mktemp(kind), kind)
        page.write(folder, recording, SCHEMA, folder / "report.html", predicted(folder))
        found[kind] = folder
    return found


def predicted(folder):
    """What a diagnosis predicted of a query, where it had one."""
    path = folder / "predicted.parquet"
    return path if path.is_file() else None


def page_of(written, kind):
    return (written[kind] / "report.html").read_text(encoding="utf-8")


def edited(folder, file, change):
    """Change the content of a JSON file of a folder in place."""
    path = folder / file
    content = json.loads(path.read_text(encoding="utf-8"))
    change(content)
    path.write_text(json.dumps(content), encoding="utf-8")


def rewritten(folder):
    source, out = folder / "recording.parquet", folder / "report.html"
    page.write(folder, source, SCHEMA, out, predicted(folder))
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_one_file_that_needs_no_other(written, kind):
    text = page_of(written, kind)
    parsed = Page(text)
    assert len(parsed.ids) == len(set(parsed.ids))
    for word in ("http:", "https:", "src=", "<link", "<script", "@import", "<iframe", "nan"):
        assert word not in text, word
    for tag, key, value in parsed.attributes:
        if key == "href":
            assert tag in ("use", "a") and value.removeprefix("#") in parsed.ids
        for reference in re.findall(r"url\((.*?)\)", value or ""):
            assert reference.removeprefix("#") in parsed.ids


@pytest.mark.parametrize("kind", KINDS)
def test_it_says_what_the_diagnosis_says(written, kind):
    folder = written[kind]
    diagnosis = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    text = Page(page_of(written, kind)).text
    for effect in diagnosis["effects"]:
        assert effect["sentence"] in text
        assert all(name in text for name in effect["alternatives"])
    assert (diagnosis["other"]["sentence"] or "") in text
    assert all(name in text for name in diagnosis["unobservable"])
    assert "0.49910 (90 %: 0.49870 to 0.49960)" in text
    assert "the odd half of reciprocal pairs" in text


def test_an_effect_comes_with_numbers_and_a_mend(written):
    text = Page(page_of(written, "explained")).text
    assert "ratio = 2.104 (90 %: 2.087 to 2.121)" in text
    assert "Clean and re-seat electrode 7." in text
    assert "in the median channel, and in all others. Found from" in text
    assert "The 20 states of the query are predicted" in text
    assert "states of the query" not in page_of(written, "consistent")


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """A folder whose diagnosis tells of the rig, with its report."""
    folder, _ = diagnosed(tmp_path_factory.mktemp("rig"), "partly-explained")
    with_rig(folder)
    rewritten(folder)
    return folder


def test_the_rig_is_told_where_it_was_found(written, rig):
    text = Page((rig / "report.html").read_text(encoding="utf-8")).text
    for sentence in rig_words.noise_sentences(RIG):
        assert re.sub(r"\s", " ", sentence) in text
    assert "gain-walk0.200 (90 %: 0.160 to 0.250) %the recording" in text
    assert "force-per-press2 %assumed" in text
    assert "noise and the rig's errors alone give 1." in text
    before = Page(page_of(written, "partly-explained")).text
    assert "The rig" not in before and "rig's errors" not in before


def test_candidates_are_not_told_as_findings(written, rig):
    text = Page((rig / "report.html").read_text(encoding="utf-8")).text
    assert "nothing is certain yet" in text and "What is certain" not in text
    assert "Candidates, to be tried Perhaps electrode 7 has" in text
    assert "assumes. This recording cannot tell it from electrode width." in text
    assert "1. Perhaps electrode 7 has" in text
    assert "contact-impedance, a candidate, electrode 7" in text
    assert "perhaps contact-impedance: electrode 7" in (
        (rig / "figures" / "electrodes.svg").read_text(encoding="utf-8")
    )
    assert "Candidates" not in Page(page_of(written, "partly-explained")).text


def test_which_frames_took_no_part_is_told(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    assert omitted_frames(evidence) == []
    few = evidence.frames.copy()
    few.loc[few.index[few["touch"]][:2], "force_N"] = np.nan
    few = few.iloc[:-1]
    count, touched = len(few), few["touch"].sum()
    assert omitted_frames(replace(evidence, frames=few)) == [
        f"An excerpt was diagnosed: {count} of {count + 1} frames.",
        f"Of {touched} touched frames 2 took no part: the force is not known.",
    ]


def test_frames_touched_without_a_label_are_told_and_no_excerpt(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    noise = {"components": [], "unlabelled": [[3, 5], [9, 9]]}
    few = replace(
        evidence,
        frames=evidence.frames.drop(index=[3, 4, 5, 9]),
        diagnosis=evidence.diagnosis | {"noise": noise},
    )
    assert omitted_frames(few) == [
        "In frames 3 to 5 there is a touch that no label tells; these frames are left out.",
        "In frame 9 there is a touch that no label tells; this frame is left out.",
    ]
    count = len(few.frames) - 1
    (_, _, excerpt) = omitted_frames(replace(few, frames=few.frames.iloc[1:]))
    assert excerpt == f"An excerpt was diagnosed: {count} of {count + 5} frames."


def test_averages_are_told_and_no_excerpt(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    noise = {"components": [], "frames_each": 5.5}
    few = replace(
        evidence,
        frames=evidence.frames.iloc[:6],
        diagnosis=evidence.diagnosis | {"noise": noise},
    )
    assert omitted_frames(few) == [
        "Averages of about 5.5 frames were diagnosed, 6 of them: what changes from frame to frame"
        " was not sought, and a reading below is an average."
    ]


def test_what_was_put_aside_is_told(written, rig):
    frames = read(written["explained"], *_rest(written["explained"])).frames
    count = frames["last"].sum()
    assert 0 < count < len(frames)
    text = Page(page_of(written, "explained")).text
    assert f"On {count} frames that decided nothing, the misfit" in text
    assert f"{count} frames were put aside before anything was looked at" in text
    text = Page(page_of(written, "untouched")).text
    assert "26 of 208 channels were put aside before anything was looked at" in text
    assert "white noise alone" not in text
    text = Page((rig / "report.html").read_text(encoding="utf-8")).text
    assert "against white noise alone" in text


def test_before_stands_with_its_own_sizes_beside(written, rig):
    text = Page((rig / "report.html").read_text(encoding="utf-8")).text
    fit = read(rig, *_rest(rig)).diagnosis["fit"]["last"]
    own = number(fit["chi2_per_dof_before_own_sizes"])
    assert f"({own} with the rig's errors as learned before) to" in text
    assert f"in the sizes learned before, the misfit before is {own}." in text
    assert "as learned before" not in Page(page_of(written, "explained")).text


def test_hollow_dots_are_against_white_noise(written, rig):
    for folder, factors in ((written["partly-explained"], [1, 1]), (rig, [1, 1, 3, 3])):
        evidence = read(folder, *_rest(folder))
        fit = evidence.diagnosis["fit"]["last"]
        after, before = fit["chi2_per_dof_after"], fit["chi2_per_dof_before"]
        dots = [
            float(line.get_xdata()[0])
            for line in figures.draw(evidence)["last"].axes[0].lines
            if line.get_marker() in plotting.MARKERS
        ]
        expected = np.array(factors) * ([before, after] * 2)[: len(factors)]
        assert sorted(dots) == pytest.approx(sorted(expected))


@pytest.mark.usefixtures("undrawn")
def test_folders_of_an_earlier_version_are_read(tmp_path):
    folder, _ = diagnosed(tmp_path, "consistent")
    path = folder / "evidence" / "residuals.npz"
    with np.load(path) as file:
        arrays = dict(file)
    last = arrays.pop("last")
    for name in ("last_channels", "changes", "changed_frame"):
        del arrays[name]
    np.savez(path, **arrays, held_out=last)
    assert read(folder, *_rest(folder)).frames["last"].sum() == last.sum()
    np.savez(path, **arrays, held_out=np.zeros_like(last))
    evidence = read(folder, *_rest(folder))
    assert not evidence.last_channels.any() and len(evidence.last_channels) == 208
    text = Page(rewritten(folder)).text
    assert "put aside" not in text and "frames held out in turn" in text


def test_figures_are_drawn_or_their_absence_told(written):
    drawn = {kind: page_of(written, kind).count("<svg ") for kind in KINDS}
    assert drawn["explained"] == len(figures.FIGURES) + 1  # what the effect changes
    assert drawn["untouched"] == 5
    text = Page(page_of(written, "untouched")).text
    assert "No frame was touched: there is no misfit against force." in text
    assert "No effect was named" in text


@pytest.mark.parametrize("kind", KINDS)
def test_every_figure_is_a_file_in_both_formats(written, kind):
    for name in figures.FIGURES:
        path = written[kind] / "figures" / name
        assert path.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
        svg = path.with_suffix(".svg").read_text(encoding="utf-8")
        width = float(re.search(r'<svg [^>]*width="([\d.]+)pt"', svg)[1])
        assert width == pytest.approx(85 / 25.4 * 72, rel=1e-3)


def test_equal_inputs_give_equal_bytes(written, tmp_path):
    folder, recording = diagnosed(tmp_path / "again", "explained")
    page.write(folder, recording, SCHEMA, folder / "report.html", predicted(folder))
    first = written["explained"]
    files = [path.relative_to(folder) for path in sorted(folder.rglob("*")) if path.is_file()]
    assert len(files) > 25
    for file in files:
        assert (folder / file).read_bytes() == (first / file).read_bytes(), file


def test_what_an_effect_changes_stands_beside_its_sentence(written):
    parsed = Page(page_of(written, "explained"))
    caption = "What it changes in a frame touched with 6 N, that in which it changes most"
    assert caption in parsed.text
    assert any(
        key == "aria-label" and value.startswith(caption) for _, key, value in parsed.attributes
    )
    evidence = read(written["explained"], *_rest(written["explained"]))
    (figure,) = figures.draw_changes(evidence)
    cells = figure.axes[0].collections[0].get_array()
    k = int(np.nanargmax(np.abs(evidence.effect_changes[0])))
    assert cells[CHANNELS[k, 0], CHANNELS[k, 2]] == pytest.approx(evidence.effect_changes[0, k])
    low, high = figure.axes[0].collections[0].get_clim()
    assert -low == high == pytest.approx(abs(evidence.effect_changes[0, k]))
    for unknown in (np.nan, 0.0):
        assert figures.draw_changes(
            replace(evidence, effect_changes=0.0 * evidence.effect_changes + unknown)
        ) == [None]


def test_before_and_after_are_drawn_from_the_residuals(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    drawn = figures.draw(evidence)
    titles = [axes.get_title() for axes in drawn["residual_matrix"].axes[:2]]
    rms = [
        float(np.sqrt(np.nanmean(r**2)))
        for r in (evidence.residual_before, evidence.residual_after)
    ]
    assert [float(title.rpartition(" ")[2]) for title in titles] == pytest.approx(rms, rel=5e-3)
    before, after = (axes.collections[0].get_array() for axes in drawn["residual_matrix"].axes[:2])
    k = int(np.nanargmax(np.abs(np.nanmean(evidence.residual_before, axis=0))))
    source, _, plus, _ = CHANNELS[k]
    assert before[source, plus] == pytest.approx(np.nanmean(evidence.residual_before[:, k]))
    assert after[source, plus] == pytest.approx(np.nanmean(evidence.residual_after[:, k]))
    assert before.mask.sum() == 16 * 16 - len(CHANNELS)
    lines = drawn["misfit_time"].axes[0].lines
    assert lines[0].get_ydata() == pytest.approx(np.nanmean(evidence.residual_before**2, axis=1))
    assert {lines[0].get_color(), lines[1].get_color()} == {plotting.BEFORE}


@pytest.mark.parametrize("kind", ["explained", "unexplained"])
def test_no_text_of_a_figure_is_cut(written, kind):
    evidence = read(written[kind], *_rest(written[kind]))
    with plotting.style():
        for name, figure in figures.draw(evidence).items():
            if isinstance(figure, str):
                continue
            figure.canvas.draw()
            for text in figure.findobj(Text, include_self=False):
                if text.get_visible() and text.get_text() and text.axes is not None:
                    inside = text.get_window_extent().padded(-1.0)
                    x, y = figure.bbox.width, figure.bbox.height
                    within = inside.x0 >= 0 and inside.y0 >= 0 and inside.x1 <= x
                    assert within and inside.y1 <= y, (name, text.get_text())


def test_nothing_in_a_figure_is_told_by_colour_alone(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    drawn = figures.draw(evidence)
    for name in ("misfit_force", "misfit_time"):
        lines = [line for line in drawn[name].axes[0].lines if line.get_label() in TITLES]
        assert [(line.get_label(), line.get_marker()) for line in lines] == [*TITLES.items()]
    before = drawn["residual_matrix"].axes[0]
    cells, dashes = (each for each in before.collections[:2])
    limit = cells.get_clim()[1]
    row, place = np.nonzero(cells.get_array().filled(0.0) < -limit / 3)
    assert len(row) and sorted(map(tuple, dashes.get_offsets())) == sorted(
        zip(place, row, strict=True)
    )


def test_matrices_far_apart_have_a_scale_each(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    for factor, bars in ((1.0, 1), (100.0, 2)):
        drawn = figures.draw(replace(evidence, residual_before=factor * evidence.residual_before))[
            "residual_matrix"
        ]
        limits = [axes.collections[0].get_clim()[1] for axes in drawn.axes[:2]]
        assert len(drawn.axes) == 2 + bars and len(set(limits)) == bars
        assert all(float(f"{limit:.0e}") == pytest.approx(limit) for limit in limits)


def test_a_long_gap_leaves_the_shaded_band_in_sight(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    for then, scale in ((14.6, "linear"), (900.0, "log")):
        pair = {**evidence.experiment["pairs"][0], "gap_now": 0.0, "gap_then": then}
        drawn = figures.next_experiment(replace(evidence, experiment={"pairs": [pair]}))
        (axes,) = drawn.axes
        assert axes.get_xscale() == scale
        assert [text.get_text() for text in axes.texts if text.get_text()] == [
            "now 0",
            f"then {number(then, 2)}",
        ]


def test_one_frame_has_no_misfit_against_time_and_frames_are_whole(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    for key in ("frames", "residual_before", "residual_after"):
        evidence = replace(evidence, **{key: getattr(evidence, key)[:2]})
    indexed = replace(evidence.recording, metadata=evidence.recording.metadata | {"clock": "index"})
    ticks = figures.misfit_time(replace(evidence, recording=indexed)).axes[0].get_xticks()
    assert (ticks == np.round(ticks)).all()
    assert "One frame" in figures.misfit_time(replace(evidence, frames=evidence.frames[:1]))


def test_long_lists_and_many_numbers_stay_in_the_figure(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    one = evidence.diagnosis["effects"][0] | {"electrodes": [2, 5, 7, 9, 10, 15], "certain": False}
    one |= {"name": "force-dependent-impedance"}
    several = evidence.diagnosis | {"effects": [one] * 5}
    with plotting.style():
        drawn = figures.electrode_ring(replace(evidence, diagnosis=several))
        assert "+3" in [text.get_text() for text in drawn.axes[0].texts]
        drawn.canvas.draw()
        assert len(drawn.texts) == 1 + 2 * 5
        assert all(text.get_window_extent().x1 <= drawn.bbox.width for text in drawn.texts)


@pytest.mark.usefixtures("undrawn")
def test_what_was_not_compared_is_not_told_as_without_rivals(tmp_path):
    folder, _ = diagnosed(tmp_path, "explained")
    path = folder / "evidence" / "identifiability.csv"
    table = pd.read_csv(path, keep_default_na=False, na_values={"snr": "", "gap": ""})
    table.loc[:, ["nearest", "gap", "observable"]] = "", np.nan, True
    table.loc[table["name"] == "electrode-open", "snr"] = np.nan
    table.to_csv(path, index=False)
    text = rewritten(folder)
    assert text.count("<td>yes, no rival</td>") == 1  # what is named
    assert text.count("<td>taken as observable; not compared</td>") == 1
    assert text.count("<td>observable; not compared</td>") == len(table) - 2


def test_a_patch_bears_its_number(tmp_path):
    folder, _ = diagnosed(tmp_path, "explained")
    with_every_effect(folder)
    evidence = read(folder, *_rest(folder))
    names = [effect["name"] for effect in evidence.diagnosis["effects"]]
    texts = figures.draw(evidence)["electrodes"].axes[0].texts
    numbers = [text.get_text() for text in texts if text.get_bbox_patch() is not None]
    assert str(names.index("conductivity-patch") + 1) in numbers


def _rest(folder):
    return folder / "recording.parquet", SCHEMA, predicted(folder)


@pytest.mark.usefixtures("undrawn")
def test_what_the_diagnosis_writes_is_text_not_markup(tmp_path):
    folder, _ = diagnosed(tmp_path, "partly-explained")
    evil = "<script>alert('x')</script> & <b>"

    def change(diagnosis):
        diagnosis["recording"] = diagnosis["effects"][0]["sentence"] = evil
        diagnosis["other"] |= {"sentence": evil, "law": evil}

    edited(folder, "diagnosis.json", change)
    edited(folder, "evidence/experiment.json", lambda e: e["pairs"][0].update(recipe=evil))
    table = pd.read_csv(folder / "evidence" / "search.csv")
    table.assign(sites=evil, p_value=0.0).to_csv(folder / "evidence" / "search.csv", index=False)
    parsed = Page(rewritten(folder))
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert "<script>" not in text and "&lt;10⁻³⁰⁰" in text and "<10⁻³⁰⁰" not in text
    assert unescape(parsed.text).count(evil) >= 6


@pytest.mark.parametrize("marked", [True, False])
@pytest.mark.usefixtures("undrawn")
def test_the_part_that_the_report_is_of_is_the_one_that_is_told(tmp_path, marked):
    """Frames alone do not say which it is; files of before have no mark."""
    folder, _ = diagnosed(tmp_path, "consistent")

    def change(diagnosis):
        own = {key: diagnosis[key] for key in PART_KEYS}
        told = {"frames": [0, 60], **own, **({"told": True} if marked else {})}
        step = {"frame": 61, "sentences": ["All is other."], "difference": {}}
        diagnosis |= {"parts": [told, {"frames": [61, 200], **own}], "steps": [step]}

    edited(folder, "diagnosis.json", change)
    text = Page(rewritten(folder)).text
    which = "frames 0 to 60, " if marked else ""
    assert f"The rest of this report is of {which}the longest part that could be" in text
    assert "Frames 61 to 200" in text and "All is other." in text


@pytest.mark.usefixtures("undrawn")
def test_sites_of_every_kind_and_no_gap(tmp_path):
    """Every name of the catalogue at its sites is mended in words without a gap."""
    folder, _ = diagnosed(tmp_path, "explained")

    with_every_effect(folder)
    text = Page(rewritten(folder)).text
    assert "{" not in text
    assert text.count("No other name looks like it.") == len(EFFECTS) - 2
    for words in (
        "Clean and re-seat electrodes 2 and 5.",
        "Put the wires of electrodes 2 and 5 back in their places.",
        "Calibrate channels 2 and 5 with a resistor phantom.",
        "Check the current with electrodes 2 and 5 as source.",
        "Zero the amplifier at the measuring pairs at electrodes 2 and 5 with its inputs shorted.",
    ):
        assert words in text


@pytest.mark.usefixtures("undrawn")
def test_dense_values_are_summed_up(tmp_path):
    folder, _ = diagnosed(tmp_path, "explained")

    def change(diagnosis, half=0.01):
        value = np.linspace(0.9, 1.0, 208)
        value[13] = 1.3
        gain = {"value": value, "low": value - half, "high": value + half}
        gain = {key: numbers.tolist() for key, numbers in gain.items()} | {"unit": "1"}
        new = {"name": "channel-gain", "scope": "dense", "electrodes": [], "parameters": {}}
        new |= {"channels": list(range(208)), "parameters": {"gain": gain}}
        diagnosis["effects"][0] |= new

    edited(folder, "diagnosis.json", change)
    text = Page(rewritten(folder)).text
    ends = "0.900 (90 %: 0.890 to 0.910) to 1.300 (90 %: 1.290 to 1.310)"
    assert f"anything from {ends}, farthest out at channel 13" in text
    assert "channel-gain, 208 channels, static" in text
    edited(folder, "diagnosis.json", partial(change, half=50.0))
    text = Page(rewritten(folder)).text
    assert "about 1 (90 %: -49 to 51)".replace("-", MINUS) in text
    assert "farthest out" not in text


def test_the_atlas_shows_what_is_significant(written):
    folder = written["explained"]
    table = pd.read_csv(folder / "evidence" / "atlas_before.csv")
    assert (table["q"] < 0.05).all()
    text = Page(page_of(written, "explained")).text
    assert "16 of 16 statistics at a false discovery rate of 5 %" in text
    assert "None of 16 statistics is significant." in text


def test_rivals_begin_with_what_is_named_where_that_is_told(written, tmp_path):
    evidence = read(written["explained"], *_rest(written["explained"]))
    drawn = figures.rivals(evidence).axes[0]
    told = [text.get_text() for text in drawn.texts]
    value = evidence.tables["rivals"]["chi2_per_dof"][0]
    assert told[:3] == ["all that is named", number(value), "without contact-impedance"]
    folder, _ = diagnosed(tmp_path, "explained")
    path = folder / "evidence" / "rivals.csv"
    pd.read_csv(path).iloc[1:].to_csv(path, index=False)
    drawn = figures.rivals(read(folder, *_rest(folder))).axes[0]
    assert drawn.texts[0].get_text() == "without contact-impedance"


@pytest.mark.usefixtures("undrawn")
def test_what_was_found_first_on_fewer_frames_is_on_the_path(written, tmp_path):
    assert "Start: found before" not in Page(page_of(written, "explained")).text
    folder, _ = diagnosed(tmp_path, "explained")
    path = folder / "evidence" / "search.csv"
    pd.read_csv(path).replace({"action": {"add": "start"}}).to_csv(path, index=False)
    text = Page(rewritten(folder)).text
    assert "startelectrode-widthelectrodes 7" in text
    assert "Start: found before" in text


@pytest.mark.usefixtures("undrawn")
def test_several_of_one_start_say_the_misfit_of_all_once(tmp_path):
    folder, _ = diagnosed(tmp_path, "explained")
    path = folder / "evidence" / "search.csv"
    row = pd.read_csv(path).iloc[[0]]
    row = row.assign(action="start", chi2=1234.5, log_evidence=-4321.0)
    last = row.assign(action="add", step=4)
    steps = [row.assign(step=k, chi2=chi2) for k, chi2 in ((1, 1234.5), (2, 1234.5), (3, 1111.0))]
    pd.concat([*steps, last]).to_csv(path, index=False)
    text = Page(rewritten(folder)).text
    assert text.count("1234.5") == 2 and text.count("1111") == 1


def test_an_unfinished_folder_is_refused(tmp_path):
    folder, _ = diagnosed(tmp_path, "consistent")
    path = folder / "evidence" / "rivals.csv"
    path.write_text("effect,instead\n")
    with pytest.raises(InputError, match=r"rivals.csv: columns: found effect, instead, expected"):
        rewritten(folder)
    path.unlink()
    with pytest.raises(InputError, match=r"rivals.csv: file: found no such file"):
        rewritten(folder)
    assert not (folder / "report.html").exists()


def test_a_prediction_without_its_spread_is_refused(tmp_path):
    folder, _ = diagnosed(tmp_path, "explained")
    table = pd.read_parquet(folder / "predicted.parquet")
    table.drop(columns="std_V").to_parquet(folder / "predicted.parquet")
    with pytest.raises(InputError, match=r"predicted.parquet: column std_V: found nothing"):
        rewritten(folder)


def test_residuals_of_another_shape_are_refused(tmp_path):
    folder, _ = diagnosed(tmp_path, "consistent")
    path = folder / "evidence" / "residuals.npz"
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **arrays | {"after": arrays["after"][:, :-1]})
    with pytest.raises(InputError, match=r"residuals.npz: after: found shape"):
        rewritten(folder)
    del arrays["noise_source"]
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=r"residuals.npz: noise_source: found nothing"):
        rewritten(folder)


def test_touches_that_nothing_simulates_have_no_map(tmp_path):
    folder, recording = diagnosed(tmp_path, "consistent")
    evidence = read(folder, recording, SCHEMA)
    touched = evidence.frames["touch"].to_numpy(bool)
    for residual in (evidence.residual_before, evidence.residual_after):
        residual[touched] = np.nan
    assert "there is no map" in figures.misfit_place(evidence)


def test_a_number_that_is_none_is_refused(tmp_path):
    folder, _ = diagnosed(tmp_path, "explained")
    path = folder / "evidence" / "identifiability.csv"
    table = pd.read_csv(path, dtype=str)
    table.loc[3, "gap"] = "large"
    table.to_csv(path, index=False)
    with pytest.raises(InputError, match=r"column gap, row 3: found 'large'"):
        rewritten(folder)


def stops(folder):
    """The rows of the table of names that are no effects."""
    text = (folder / "report.html").read_text(encoding="utf-8")
    (table,) = re.findall(r"<details>.*?<tbody>(.*?)</tbody>", text, re.DOTALL)
    rows = [re.findall(r"<td.*?>(.*?)</td>", row) for row in table.strip().splitlines()]
    return {re.sub("<.*?>", "", name): cells for name, *cells in rows}


@pytest.mark.parametrize("kind", KINDS)
def test_where_every_other_name_stopped_unfolds(written, kind):
    """With value, threshold and sentence, as `eitskin explain` has them."""
    diagnosis, decisions = refusals.read(written[kind])
    effects = [effect["name"] for effect in diagnosis["effects"]]
    rows = stops(written[kind])
    assert sorted(rows) == sorted({*catalogue_names()} - {*effects})
    assert rows.pop(UNMET) == [NONE, NONE, NONE, "It met no gate."]
    assert {"names", "evidence", "prediction"} == {
        re.sub("<.*?>", "", gate) for gate, *_ in rows.values()
    }
    for name, (gate, value, passes, sentence) in rows.items():
        stop = refusals.stop(decisions, effects, name)
        assert gate == f"<code>{stop.gate.name}</code>" and value == number(stop.value)
        assert passes == f"{stop.gate.passes} {number(stop.gate.threshold)}"
        assert unescape(sentence) == stop.sentence


def test_decisions_are_read_as_the_search_recorded_them(written):
    table = read(written["explained"], *_rest(written["explained"])).tables["decisions"]
    assert list(table) == [field.name for field in fields(Decision)]
    _, decisions = refusals.read(written["explained"])
    pd.testing.assert_frame_equal(table, decisions, check_dtype=False)


def test_a_folder_without_decisions_says_so(tmp_path, undrawn):
    folder, _ = diagnosed(tmp_path, "explained")
    (folder / "evidence" / "decisions.csv").unlink()
    text = rewritten(folder)
    assert "<details><summary>Where" not in text and "decisions.csv" not in text
    assert "did not record the decisions of its search" in Page(text).text


@pytest.mark.parametrize(
    ("column", "cell", "refusal"),
    [
        ("gate", "luck", "column gate, row 3: found 'luck', expected a gate"),
        ("admitted", "perhaps", "column admitted, row 3: found 'perhaps'"),
        ("value", "large", "column value, row 3: found 'large'"),
    ],
)
def test_decisions_that_are_none_are_refused(tmp_path, column, cell, refusal):
    folder, _ = diagnosed(tmp_path, "explained")
    path = folder / "evidence" / "decisions.csv"
    table = pd.read_csv(path, dtype=str)
    table.loc[3, column] = cell
    table.to_csv(path, index=False)
    with pytest.raises(InputError, match=rf"decisions.csv: {refusal}"):
        rewritten(folder)


def test_the_workflow_knows_every_figure_and_captions_it():
    rule = RULES.read_text(encoding="utf-8")
    for name in figures.FIGURES:
        assert f'"{name}":' in rule
        assert (CAPTIONS / f"{name}.rst").is_file()
    assert set(page.CAPTIONS) == set(figures.FIGURES)


def test_a_map_of_some_places_says_how_many_and_why(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    assert figures.unmapped_text(evidence) == ""
    press = evidence.frames["press"].to_numpy()
    residual = evidence.residual_after.copy()
    residual[press == press.max()] = np.nan
    count = press.max() + 1
    told = figures.unmapped_text(replace(evidence, residual_after=residual))
    assert told.startswith(f" It has {count - 1} of {count} places: at the others every touch was")


def test_the_error_before_and_after_is_of_what_was_put_aside_in_one_scale(written):
    evidence = read(written["explained"], *_rest(written["explained"]))
    drawn = figures.hidden_error(evidence)
    panels = [axes.collections[0] for axes in drawn.axes[:2]]
    assert panels[0].get_clim() == panels[1].get_clim()
    for panel, error in zip(panels, (evidence.last_before_V, evidence.last_after_V), strict=True):
        is_last = evidence.frames["last"].to_numpy()
        assert np.isfinite(error[is_last]).any() and np.isnan(error[~is_last]).all()
        k = int(np.nanargmax(np.nanmean(error[is_last] ** 2, axis=0)))
        largest = np.sqrt(np.nanmean(error[is_last, k] ** 2))
        assert panel.get_array().max() * 1e-6 == pytest.approx(largest)
    (panel,) = [
        axes
        for axes in figures.hidden_error(
            read(written["consistent"], *_rest(written["consistent"]))
        ).axes
        if axes.get_title()
    ]
    assert panel.get_title().startswith("error: ")
