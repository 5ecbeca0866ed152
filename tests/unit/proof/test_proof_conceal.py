"""What a concealed case shows, and what is put under lock."""

import io
import json
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.stats import ks_2samp

from eitskin.data import recording
from proof import conceal, refit, sealing
from proof.conceal import LEAST_LEVEL, MOST_LEVEL, NEAR, Sizes
from proof.panel import Planned
from witness import cases
from witness.cases import Blinding, draw

SIZES = Sizes(cases=3, frames=40, query_frames=20)
PLAN = {
    "case-001": Planned("null", 11, "boundary", (), None),
    "case-002": Planned("single:drive-gain", 12, "boundary", ("drive-gain",), 8.0),
    "case-003": Planned("outside:source-sag", 13, "boundary", None, None),
}
ROOT = bytes(range(32))
KINDS = {
    "null": (),
    "single:contact-impedance": ("contact-impedance",),
    "single:conductivity-patch": ("conductivity-patch",),
    "outside:palm": None,
}


def of(name, seed, public, truths, code="code"):
    return conceal.Block(name, SIZES, seed, public, truths, code)


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    """A concealed block of PLAN; its folder, that of its truths, its commitments."""
    folder = tmp_path_factory.mktemp("block")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(conceal, "plan", lambda *_: PLAN)
        made = conceal.conceal(of("demo", 4, folder / "public", folder / "truths"), list(PLAN))
    return folder / "public", folder / "truths", made


def truth(block, name):
    _public, truths, _made = block
    key = sealing.derived(sealing.root_of("demo", 4, truths), "key")
    plain = sealing.open_truth(key, "demo", name, truths / f"{name}.sealed")
    return json.loads(sealing.unpacked(plain)[0])


def blind(monkeypatch, kinds: Iterable[str], seeds: range):
    """Metadata and frames that are drawn, without solving anything."""

    class Solved(Exception):
        pass

    def world(true, channels, frame_s, grounded=False, **_):
        raise Solved(grounded)

    drawn: dict[str, list] = {kind: [] for kind in kinds}
    seen: dict = {}
    for name in ("recording_frames", "query_frames", "_incomplete"):
        own = getattr(cases, name)

        def kept(*given, own=own, name=name):
            seen[name] = own(*given)
            return seen[name]

        monkeypatch.setattr(cases, name, kept)
    monkeypatch.setattr(cases, "World", world)
    for kind in kinds:
        names = None if KINDS[kind] is None else list(KINDS[kind])
        for seed in seeds:
            with pytest.raises(Solved) as grounded:
                draw(kind, seed, 40, names=names, blinding=Blinding(20))
            drawn[kind].append((*seen.values(), grounded.value.args[0]))
    return drawn


def test_metadata_and_frames_do_not_depend_on_the_kind(monkeypatch):
    drawn = blind(monkeypatch, KINDS, range(150))
    looks = {
        "unknown contacts": lambda skin, *_: skin.contact_impedivity_ohm_m2 is None,
        "radius": lambda skin, *_: skin.radius_mm,
        "thickness": lambda skin, *_: skin.thickness_mm,
        "width": lambda skin, *_: skin.electrode_width_mm,
        "contrast": lambda skin, *_: skin.contrast_per_N,
        "current": lambda skin, *_: skin.current_A,
        "presses": lambda skin, frames, *_: frames["contact"].max(),
        "force": lambda skin, frames, *_: frames["force_N"].max(),
        "time": lambda skin, frames, *_: frames["time_s"].max(),
        "reach": lambda skin, frames, *_: np.hypot(frames["x_mm"], frames["y_mm"]).max(),
        "nearest": lambda skin, frames, *_: np.hypot(frames["x_mm"], frames["y_mm"]).min(),
        "query": lambda skin, frames, query, _: query["force_N"].max(),
    }
    for kind, several in drawn.items():
        assert all(len(f) == 40 and len(q) == 20 for _, f, q, _ in several)
        assert all(grounded for *_, grounded in several)
        keys = {tuple(skin.metadata()) for skin, *_ in several}
        assert len(keys) == 1 and keys == {tuple(drawn["null"][0][0].metadata())}
        for name, look in looks.items():
            here, there = ([float(look(*one)) for one in drawn[k]] for k in (kind, "null"))
            assert kind == "null" or ks_2samp(here, there, method="asymp").pvalue > 1e-4, (
                kind,
                name,
            )


def test_the_hints_of_calibration_would_be_seen(monkeypatch):
    """The same test's measure, on what it must not miss."""
    drawn = blind(monkeypatch, ["null", "single:contact-impedance"], range(60))
    unknown = {k: [s.contact_impedivity_ohm_m2 is None for s, *_ in v] for k, v in drawn.items()}
    assert 0.15 < np.mean(unknown["single:contact-impedance"]) < 0.55
    plain = [
        cases._incomplete(
            np.random.default_rng(s),
            cases._draw_skin(np.random.default_rng(s)),
            ["contact-impedance"],
            False,
        )
        for s in range(60)
    ]
    assert not any(skin.contact_impedivity_ohm_m2 is None for skin in plain)


def test_touches_keep_clear_whatever_the_kind(monkeypatch):
    for _, frames, query, _ in blind(monkeypatch, ["null"], range(5))["null"]:
        assert frames["touch"].any() and query["touch"].any()
    keep = cases.Keep(((10.0, 0.0, 13.0),), 1.5, clear=True)
    assert not keep.allows(10.0, 0.0, 3.5) and cases.Keep(keep.discs).allows(10.0, 0.0, 3.5)
    assert keep.allows(10.0, 18.1, 3.5) and not keep.allows(10.0, 17.9, 3.5)


@pytest.mark.parametrize("seed", range(3))
def test_nobody_varies_all_contacts_where_nobody_knows_them(seed):
    rng = np.random.default_rng(seed)
    skin = cases._draw_skin(rng)
    for _ in range(60):
        scene = cases.strengths.Scene(
            cases.replace(skin, contact_impedivity_ohm_m2=None),
            cases.channel_table(16),
            np.ones(208),
            None,
            True,
            3.0,
        )
        assert cases._drawn("contact-impedance", rng, scene).scope != "common"


def test_files_are_told_apart_by_their_number_alone(block):
    public, truths, _made = block
    for folder, suffix in (("recordings", "parquet"), ("queries", "parquet")):
        found = sorted((public / folder).iterdir())
        assert [f.name for f in found] == [f"{name}.{suffix}" for name in PLAN]
        sizes = [f.stat().st_size for f in found]
        assert max(sizes) < 1.02 * min(sizes)
    sealed = [(truths / f"{name}.sealed").stat().st_size for name in PLAN]
    assert len(set(sealed)) == 1
    metadata = []
    for name in PLAN:
        read = recording.read(public / "recordings" / f"{name}.parquet")
        query = recording.read(public / "queries" / f"{name}.parquet")
        assert len(read.frames) == 40 and len(query.frames) == 20 and query.voltage is None
        metadata.append(read.metadata)
        text = pq.read_schema(public / "recordings" / f"{name}.parquet").metadata
        assert list(text) == [b"eit"]
    for key in ("source", "source_reference", "channels", "voltage", "values", "unit", "clock"):
        assert all(one[key] == metadata[0][key] for one in metadata)
    assert len({tuple(one) for one in metadata}) == 1
    assert len({tuple(one["skin"]) for one in metadata}) == 1


def test_commitments_say_what_lies_there(block):
    public, _truths, made = block
    for name in PLAN:
        promised = made[name]
        path = public / "recordings" / f"{name}.parquet"
        assert promised["recording"]["sha256"] == sealing.salted(
            promised["recording"]["salt"], path
        )
    salts = [made[name][part]["salt"] for name in PLAN for part in ("recording", "query")]
    assert len(set(salts)) == 6
    assert set(made["case-001"]) == {"recording", "query", "truth"}


def test_a_gap_is_reached_by_the_noise(block):
    told = truth(block, "case-002")
    assert told["gap_wanted"] == 8.0 and told["effects"][0]["name"] == "drive-gain"
    assert told["gap_reached"] == min(listed[0][1] for listed in told["gaps"])
    inside = LEAST_LEVEL < told["level"] < MOST_LEVEL
    assert not inside or abs(told["gap_reached"] / 8.0 - 1.0) < 2 * NEAR
    assert LEAST_LEVEL <= told["level"] <= MOST_LEVEL
    assert 0.0 < told["changed"] < 1.0
    assert set(told["similarity"]) == {"mmd", "coral", "ncc", "swd"}


def test_a_null_has_neither_effects_nor_gaps(block):
    told = truth(block, "case-001")
    assert told["effects"] == [] and told["gaps"] is None and told["outside"] is None
    assert told["changed"] == pytest.approx(0.0, abs=1e-9)
    assert LEAST_LEVEL <= told["level"] <= MOST_LEVEL
    assert sum(one["moved"] for one in told["similarity"].values()) <= 1  # 1 in 20 is chance


def test_the_recording_is_the_truth_and_its_noise(block):
    public, truths, _ = block
    key = sealing.derived(sealing.root_of("demo", 4, truths), "key")
    for name in PLAN:
        plain = sealing.open_truth(key, "demo", name, truths / f"{name}.sealed")
        with np.load(io.BytesIO(sealing.unpacked(plain)[1])) as arrays:
            read = recording.read(public / "recordings" / f"{name}.parquet")
            left = (read.voltage - arrays["clean_V"]) / arrays["noise_V"]
            assert left.std() == pytest.approx(1.0, abs=0.04)
            assert arrays["query_clean_V"].shape == (20, 208)


def test_snr_follows_the_noise(block):
    told = truth(block, "case-003")
    case = conceal.case_of(PLAN["case-003"], SIZES)
    assert told["outside"]["law"] == "source-sag"
    scale = case.level / told["level"]
    assert told["outside"]["snr"] == pytest.approx(case.outside["snr"] * scale)


@pytest.mark.long
def test_a_rig_with_errors_records_the_same_skin():
    planned = PLAN["case-002"]
    plain = conceal.case_of(planned, SIZES)
    case = conceal.case_of(planned, replace(SIZES, rig=True))
    assert case.rig and case.believed == plain.believed and case.effects == plain.effects
    assert case.true_states.equals(plain.states)
    seen = conceal.shown(case, planned, ROOT, "case-002")
    truth, arrays = conceal.truth_of("case-002", planned, case, seen)
    assert [error["kind"] for error in truth["rig"]] == [error.kind for error in case.rig]
    assert seen.voltage.shape == case.clean.shape == arrays["clean_V"].shape
    unharmed = conceal.shown(plain, planned, ROOT, "case-002").voltage
    told_off = not case.states.equals(plain.states)
    assert told_off or not np.array_equal(seen.voltage, unharmed, equal_nan=True)


def test_gaps_that_take_more_than_a_diagnosis_may_are_unknown(monkeypatch):
    planned = next(one for one in PLAN.values() if one.gap is not None)
    case = conceal.case_of(planned, SIZES)
    assert refit.gaps_in_noise(case, case.noise_V)
    monkeypatch.setattr(refit, "GAP_SHEETS", 2.0)
    assert refit.gaps_in_noise(case, case.noise_V) is None
    assert conceal.shown(case, planned, b"root", "case-000").gaps is None


def test_the_same_seed_gives_the_same_bytes_and_what_is_there_stays(block, tmp_path, monkeypatch):
    public, truths, made = block
    name = "case-001"
    monkeypatch.setattr(conceal, "plan", lambda *_: PLAN)
    again = conceal.conceal(of("demo", 4, tmp_path / "public", tmp_path / "truths"), [name])
    assert again[name] == made[name]
    for one, other in ((public, tmp_path / "public"), (truths, tmp_path / "truths")):
        for file in other.rglob("case-*"):
            assert file.read_bytes() == (one / file.relative_to(other)).read_bytes()
    monkeypatch.setattr(conceal, "draw", None)  # nothing is drawn again
    assert conceal.conceal(of("demo", 4, public, truths), [name])[name] == made[name]
    with pytest.raises(TypeError):
        conceal.conceal(of("demo", 4, public, truths, "another"), [name])


def test_a_random_block_is_never_drawn_again(tmp_path, monkeypatch):
    public, truths = tmp_path / "final", tmp_path / "truths"
    monkeypatch.setattr(conceal, "plan", lambda *_: PLAN)
    made = conceal.conceal(of("final", None, public, truths), ["case-001"])
    batch = tmp_path / "000.json"
    batch.write_text(json.dumps(made))
    monkeypatch.setattr(conceal, "draw", None)
    assert conceal.conceal(of("final", None, public, truths, "another"), ["case-001"]) == made
    sealing.commit("final", None, [batch], public, truths)
    assert conceal.conceal(of("final", None, public, truths), ["case-001"]) == made
    (public / "recordings" / "case-001.parquet").unlink()
    with pytest.raises(conceal.InputError, match="case-001"):
        conceal.conceal(of("final", None, public, truths), ["case-001"])
