"""One file is one effect: toys, each a file in a folder of its own, go where the catalogue's go."""

import json
import re
import sys
from html import escape
from pathlib import Path

import numpy as np
import pytest
import yaml

from diagnosed_skin import SCHEMA
from eitskin import effects
from eitskin.configuration import validate
from eitskin.data import recording
from eitskin.diagnose import diagnosis, files
from eitskin.diagnose.fitting.candidates import is_discrete
from eitskin.diagnose.fitting.tangents import Tangents
from eitskin.diagnose.report import page
from eitskin.diagnose.verdict.record import record
from eitskin.effects.effect import Moment
from eitskin.effects.settings import settings, site_counts
from eitskin.errors import InputError
from eitskin.physics.geometry import Geometry
from eitskin.physics.solver import SolvedSkins
from small_skin import (
    CHANNELS,
    SKIN,
    calibrated,
    candidates_of,
    problem_of,
    small_recording,
    states,
    voltage,
)

ROOT = Path(__file__).parents[3]
TOYS = {
    "toy_softening": '''
"""A gel that conducts better where it is pressed, the more so towards larger x."""

import math

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry


class Softening(SkinEffect):
    """sigma (1 + per_N F (1 + x / 40 mm))."""

    name = "toy-softening"
    driver = "force"
    parameters = {"per_N": Parameter("1/N", 0.0, -0.1, 0.1, scale=0.01, dense=False)}
    source = "a toy"
    mend = "press more gently"
    finding = "The gel's conductivity changes by {per_N:%} per newton."
    shown_by = "presses from light to hard"

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry as the force has it."""
        if moment.force_N == 0:
            return geometry
        factor = 1 + setting.values["per_N"] * moment.force_N * (1 + moment.x_mm / 40.0)
        return geometry.with_values(conductivity_S_per_m=geometry.conductivity_S_per_m * factor)
''',
    "toy_bleeding": '''
"""A lead that reads some of the next one's potential."""

import numpy as np

from eitskin.effects.effect import Combination, Parameter, Setting, WiringEffect


class Bleeding(WiringEffect):
    """u_l (1 - share) + share u_(l + 1)."""

    name = "toy-bleeding"
    order = "open"
    driver = "static"
    sites = ("electrodes",)
    parameters = {"share": Parameter("1", 0.0, -0.5, 0.5, scale=0.05)}
    source = "a toy"
    mend = "part the lead of electrode {site} from the next"
    finding = "{site} {reads|read} {share:%} of the next one's potential."
    shown_by = "absolute values"

    def change(
        self,
        potential: np.ndarray,
        setting: Setting,
        drives: np.ndarray,
        impedance: np.ndarray,
        sink_grounded: bool,
    ) -> np.ndarray:
        """Potentials (N, D, n), those of the sites mixed."""
        mixed, at = potential.copy(), setting.sites
        beside = potential[:, :, (at + 1) % potential.shape[2]]
        mixed[:, :, at] += setting.values["share"] * (beside - potential[:, :, at])
        return mixed
''',
    "toy_swelling": '''
"""A skin that swells while it is used, the more so where it is pressed."""

from eitskin.effects.effect import Moment, Parameter, Setting, SkinEffect
from eitskin.physics.geometry import Geometry


class Swelling(SkinEffect):
    """thickness (1 + per_minute t (1 + F (1 + y / 40 mm)))."""

    name = "toy-swelling"
    driver = "time"
    parameters = {"per_minute": Parameter("1/min", 0.0, -0.1, 0.1, scale=0.01, dense=False)}
    source = "a toy"
    mend = "let it dry"
    finding = "The skin swells by {per_minute:%} per minute."
    shown_by = "a recording of an hour by a measured clock"

    def change(self, geometry: Geometry, setting: Setting, moment: Moment) -> Geometry:
        """The geometry as it is by then, and under a force."""
        pressed = moment.force_N * (1 + moment.y_mm / 40.0) if moment.force_N else 0.0
        by = setting.values["per_minute"] * moment.minutes * (1 + pressed)
        return geometry.with_values(thickness_mm=geometry.thickness_mm * (1 + by))
''',
}
BLEEDING = TOYS["toy_bleeding"].replace("toy-bleeding", "toy-silent")
ITEMS = {
    "toy-softening": {"parameters": {"per_N": 0.03}},
    "toy-bleeding": {"electrodes": [5], "parameters": {"share": 0.2}},
    "toy-swelling": {"parameters": {"per_minute": 0.004}},
}


@pytest.fixture(scope="module", autouse=True)
def catalogue(tmp_path_factory):
    """The catalogue with the toys in it, and without them again in the end."""
    folder = tmp_path_factory.mktemp("toys")
    for name, text in TOYS.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    effects.__path__.append(str(folder))
    effects.discover()
    yield
    effects.__path__.remove(str(folder))
    for name in ITEMS:
        del effects.EFFECTS[name]
    for module in TOYS:
        del sys.modules[f"{effects.__name__}.{module}"]


def item(name):
    return {"name": name, **ITEMS[name]}


def frame_by_frame(frames, name):
    """(N, M): every frame on a skin of its own, its equations written out."""
    (setting,) = settings([item(name)], site_counts(CHANNELS), (0, 0))
    readings, near = [], SolvedSkins()
    for row in frames.itertuples():
        geometry = Geometry.from_skin(SKIN)
        force_N = row.force_N if row.touch else 0.0
        if setting.effect.stage == "skin":
            moment = Moment(row.time_s / 60.0, force_N, row.x_mm, row.y_mm)
            geometry = setting.effect.change(geometry, setting, moment)
        forward = near.solve(geometry, "diagnose")
        impedance = forward.transfer_impedance()
        if row.touch:
            place = forward.place(row.x_mm, row.y_mm, 0.5 * row.probe_mm)
            impedance = impedance + place.impedance_change(np.array([0.5 * force_N]))[0]
        source, sink, plus, minus = CHANNELS.T
        potential = impedance[:, source] - impedance[:, sink]
        if name == "toy-bleeding":
            potential[5] = 0.8 * potential[5] + 0.2 * potential[6]
        at = np.arange(len(CHANNELS))
        readings.append(SKIN.current_A * (potential[plus, at] - potential[minus, at]))
    return np.array(readings)


@pytest.mark.parametrize("name", ITEMS)
@pytest.mark.parametrize("places", [3, 9])
def test_it_is_simulated_as_frame_by_frame(name, places):
    """With few and with many forces at places of their own."""
    recorded = small_recording(places=places)
    found, expected = (
        voltage(recorded, [item(name)]),
        frame_by_frame(recorded.frames, name),
    )
    assert np.abs(expected - voltage(recorded, [])).max() > 1e-3 * np.abs(expected).max()
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


def test_many_forces_at_one_place_are_interpolated_as_well():
    frames = states(1)
    frames = frames.loc[np.r_[0:4, np.full(40, 6)]].reset_index(drop=True)
    frames["time_s"] = 2.0 * np.arange(len(frames))
    frames.loc[4:, "force_N"] = np.linspace(0.5, 9.0, 40)
    recorded = small_recording(places=1)
    recorded.frames = frames.assign(frame=np.arange(len(frames)))
    for name in ITEMS:
        found, expected = voltage(recorded, [item(name)]), frame_by_frame(frames, name)
        assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()


def test_its_derivatives_are_those_of_the_simulator():
    """About a state with other effects of the skin, whose place in the frame it has."""
    recorded = small_recording(places=2)
    problem, scales = problem_of(recorded)
    about = Tangents(calibrated(problem))
    others = settings(
        [
            {"name": "contact-impedance", "parameters": {"ratio": 2.0}},
            {"name": "force-offset", "parameters": {"offset_N": 2.0}},
        ],
        site_counts(CHANNELS),
        (0, 0),
    )
    about.settings = others
    about.voltage = about.base_voltage = problem.model.voltage(about.calibration, others)
    step = 1e-3
    for candidate in candidates_of(recorded, problem, scales):
        if candidate.name not in ITEMS or candidate.scope == "dense" or is_discrete(candidate):
            continue
        up, down = (
            problem.model.voltage(about.calibration, [*others, candidate.setting(np.array([s]))])
            for s in (step, -step)
        )
        exact = about.project_out(problem.whitening((up - down) / (2 * step)).ravel())
        (found,) = about.columns(candidate)
        assert np.linalg.norm(found - exact) < 0.01 * np.linalg.norm(exact), candidate.key


def test_the_configuration_takes_it_and_knows_its_parameters(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    schema = ROOT / "workflow" / "schemas" / "config.schema.yaml"
    config = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
    for name in ITEMS:
        config["twin"]["effects"] = [item(name)]
        validate(config, schema, [ROOT / "config.yaml"])
        config["twin"]["effects"] = [{"name": name, "parameters": {"siemens": 1.0}}]
        with pytest.raises(InputError, match="siemens: found an unknown key"):
            validate(config, schema, [ROOT / "config.yaml"])


@pytest.mark.parametrize(
    "name", ["toy-softening", pytest.param("toy-bleeding", marks=pytest.mark.long)]
)
def test_a_diagnosis_names_it_and_its_report_tells_it(name, tmp_path, monkeypatch):
    for other in set(ITEMS) - {name}:
        monkeypatch.delitem(effects.EFFECTS, other)
    recorded = small_recording(item(name), places=3)
    recording.write(recorded, tmp_path / "recording.parquet")
    found = diagnosis.diagnose(recorded)
    assert [candidate.name for candidate in found.explanation.effects] == [name]
    files.write(record(found, "toy"), tmp_path, SCHEMA)
    (told,) = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))["effects"]
    for key, value in ITEMS[name]["parameters"].items():
        low, high = (told["parameters"][key][end] for end in ("low", "high"))
        assert abs(value - 0.5 * (low + high)) <= high - low  # 90 % twice as wide: 99.9 %
    assert told["electrodes"] == ITEMS[name].get("electrodes", [])
    page.write(tmp_path, tmp_path / "recording.parquet", SCHEMA, tmp_path / "report.html")
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    report = re.sub(r"</?span[^>]*>", "", report)
    known = (told["sentence"], effects.EFFECTS[name].mend.partition(" {")[0][1:])
    for words in (*known, "What it changes in a"):
        assert escape(words) in report
    corrected = yaml.safe_load((tmp_path / "effects.yaml").read_text(encoding="utf-8"))
    assert [one["name"] for one in corrected["twin"]["effects"]] == [name]


def test_it_is_known_by_its_module():
    assert effects.modules(ITEMS) == sorted(f"eitskin.effects.{module}" for module in TOYS)
    assert set(ITEMS) < set(effects.catalogue_names())


def test_a_name_is_one_effect_s(tmp_path, monkeypatch):
    (tmp_path / "toy_again.py").write_text(TOYS["toy_bleeding"], encoding="utf-8")
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    monkeypatch.delitem(sys.modules, "eitskin.effects.toy_again", raising=False)
    with pytest.raises(InputError, match=r"toy-bleeding: found that of eitskin\.effects\.toy_bl"):
        effects.discover()
    del sys.modules["eitskin.effects.toy_again"]


@pytest.fixture
def silent(tmp_path, monkeypatch):
    """The file of one more effect."""
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    yield tmp_path / "toy_silent.py"
    sys.modules.pop("eitskin.effects.toy_silent", None)


@pytest.mark.parametrize("left_out", [["mend"], ["driver", "finding"]])
def test_what_an_effect_leaves_out_is_told(silent, left_out):
    text = BLEEDING
    for one in left_out:
        assert re.search(rf"^    {one} = ", text, re.MULTILINE)
        text = re.sub(rf"^    {one} = .*\n", "", text, flags=re.MULTILINE)
    silent.write_text(text, encoding="utf-8")
    found = " and ".join(f"no {one}" for one in left_out)
    with pytest.raises(InputError, match=rf"effects\.toy_silent: toy-silent: found {found}, "):
        effects.discover()
    assert "toy-silent" not in effects.EFFECTS


@pytest.mark.parametrize(
    ("said", "instead", "told"),
    [
        ("driver = .*", 'driver = "statik"', "driver: found 'statik', expected one of static, "),
        ("order = .*", 'order = "opne"', "order: found 'opne', expected one of leak, open, swap"),
        ("    order = .*\n", "", "order: found None, expected one of leak, open, swap"),
        ("sites = .*", 'sites = ("wire",)', r"sites: found \('wire',\), expected a tuple of "),
        ("finding = .*", 'finding = "{shares:%}."', "finding: found {shares:%}, expected one of "),
        (
            "driver = .*",
            'driver = "static"\n    combination = "share"',
            "combination: found 'share', expected a Combination",
        ),
        (
            "driver = .*",
            'driver = "static"\n    combination = Combination(("size",), dict, str)',
            "combination: found size, expected some of share",
        ),
        ("    order = .*", '    stage = "wires"', "stage: found 'wires', expected a class of a"),
        ("-0.5, 0.5", "0.5, -0.5", "parameters: share: found low 0.5, high -0.5, expected low "),
        ("0.0, -0.5", "0.7, -0.5", "parameters: share, neutral: found 0.7, expected one of -0.5 "),
        ("0.0, -0.5", "None, -0.5", "parameters: share: found neutral None, expected one that do"),
        ("scale=0.05", "scale=0.0", "parameters: share, scale: found 0, expected more than 0"),
        ('"1", 0', '"", 0', "parameters: share, unit: found '', expected a unit"),
        ('"1", 0', "None, 0", "parameters: share, unit: found None, expected a unit"),
        ("scale=0.05", "of_reading=True", "parameters: share, unit: found '1', expected one of V"),
        ('Parameter\\("1.*', "1.0}", "parameters: share: found 1.0, expected a Parameter"),
        ("parameters = .*", "parameters = [1]", r"parameters: found \[1\], expected a dict of a P"),
        ("        drives: .*\n", "", r"change: found change\(self, potential, setting, impedan"),
        ("def change", "def changed", r"change: found nothing, expected change\(self, potential, "),
        (
            "    def change",
            "    change = 3\n\n    def changed",
            r"change: found 3, expected change\(",
        ),
        (
            "driver = .*",
            'driver = "static"\n    confusable = "gain",',
            "confusable: found 'gain', ",
        ),
    ],
)
def test_what_no_effect_can_say_is_told(silent, said, instead, told):
    text, count = re.subn(said, instead, BLEEDING)
    assert count == 1
    silent.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=rf"effects\.toy_silent: toy-silent: {told}"):
        effects.discover()
    assert "toy-silent" not in effects.EFFECTS


def test_an_effect_of_channels_says_its_slope(silent):
    silent.write_text(
        (Path(effects.__path__[0]) / "offset.py")
        .read_text(encoding="utf-8")
        .replace('"offset"', '"toy-silent"', 1)
        .replace("def slope", "def slopes"),
        encoding="utf-8",
    )
    with pytest.raises(InputError, match=r"slope: found nothing, expected slope\(self, voltage\)"):
        effects.discover()


def test_an_effect_without_a_name_is_told(silent):
    silent.write_text(re.sub("    name = .*\n", "", BLEEDING), encoding="utf-8")
    with pytest.raises(InputError, match=r"effects\.toy_silent: Bleeding: found no name, expec"):
        effects.discover()


@pytest.mark.parametrize(
    ("said", "instead", "told"),
    [
        (r"def change\(", "def change((", "line 22: found .*, expected Python"),
        ('"1", 0.0, ', "0.0, ", "line 16: found TypeError: .*'high', expected code that can be "),
        (
            "import Combination",
            "import Combinations",
            "line 6: found ImportError: .*, expected code",
        ),
    ],
)
def test_a_file_that_cannot_be_imported_is_one_line(silent, said, instead, told):
    text, count = re.subn(said, instead, BLEEDING)
    assert count == 1
    silent.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=f"^{re.escape(str(silent))}: {told}") as caught:
        effects.discover()
    assert "\n" not in str(caught.value)
