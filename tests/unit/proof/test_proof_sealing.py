"""The lock: what is opened when, and every byte that was changed noticed."""

import json
import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eitskin.errors import InputError
from proof import ledger, sealing

CASES = ("case-001", "case-002", "case-003")


def truth(case):
    return {"case": case, "kind": "null", "effects": [{"name": "offset", "at": 0.1}]}


def concealed(folder, seed=5, block="demo"):
    """A block of three cases with verdicts; its folder and that of its truths."""
    public, truths = folder / "results/concealed" / block, folder / "results/truths" / block
    root = sealing.root_of(block, seed, truths)
    made = {}
    truths.mkdir(parents=True, exist_ok=True)
    for number, case in enumerate(CASES):
        files = ledger.files_of(public, case)
        for file in files.values():
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(f"{case} {file.parent.name}".encode())
        plain = sealing.packed(truth(case), {"clean_V": np.full((4, 3), number / 7)})
        sealed = sealing.seal_truth(root, block, case, plain)
        (truths / f"{case}.sealed").write_bytes(sealed)
        made[case] = sealing.commitment(root, case, files, plain)
        verdict = public / "verdicts" / case / "diagnosis.json"
        verdict.parent.mkdir(parents=True, exist_ok=True)
        verdict.write_text(f'{{"recording": "{case}"}}\n')
    batch = public / "batches" / "000.json"
    batch.parent.mkdir(exist_ok=True)
    batch.write_text(json.dumps(made))
    sealing.commit(block, seed, [batch], public, truths)
    return public, truths


@pytest.fixture
def block(tmp_path):
    return concealed(tmp_path)


@pytest.fixture
def opened(block):
    public, truths = block
    sealing.seal(public)
    sealing.unlock(public, truths)
    return block


def files(folder):
    """Bytes by path."""
    return {f.relative_to(folder): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def flipped(path, place=-1):
    """Turn one bit of a file."""
    content = bytearray(path.read_bytes())
    content[place] ^= 1
    path.write_bytes(content)


def test_opening_needs_the_seal(block):
    public, truths = block
    with pytest.raises(InputError, match=r"seal\.json: file: found no such file"):
        sealing.unlock(public, truths)
    assert not (public / "opened").exists()


def test_sealed_verdicts_open_the_truths(opened):
    public, _ = opened
    for number, case in enumerate(CASES):
        folder = public / "opened"
        assert json.loads((folder / f"{case}.json").read_text()) == truth(case)
        with np.load(folder / f"{case}.npz") as arrays:
            assert np.array_equal(arrays["clean_V"], np.full((4, 3), number / 7))
    record = json.loads((public / "opened" / "opened.json").read_text())
    assert record["seal"] == sealing.check_opened(public)
    assert bytes.fromhex(record["root"]) == sealing.root_of("demo", 5, public)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("place", [0, 7, -1])
def test_a_changed_verdict_opens_nothing(block, case, place):
    public, truths = block
    sealing.seal(public)
    flipped(public / "verdicts" / case / "diagnosis.json", place)
    with pytest.raises(InputError, match=rf"verdicts/{case}/diagnosis\.json: sha256"):
        sealing.unlock(public, truths)
    assert not (public / "opened").exists()


@pytest.mark.parametrize("file", ["verdicts/case-002/more.csv", "baselines/case-001.json"])
def test_an_added_file_opens_nothing(block, file):
    public, truths = block
    sealing.seal(public)
    (public / file).parent.mkdir(exist_ok=True)
    (public / file).write_text("late\n")
    with pytest.raises(InputError, match=file):
        sealing.unlock(public, truths)


def test_a_missing_verdict_opens_nothing(block):
    public, truths = block
    sealing.seal(public)
    (public / "verdicts/case-003/diagnosis.json").unlink()
    with pytest.raises(InputError, match=r"case-003/diagnosis\.json: sha256: found no such file"):
        sealing.unlock(public, truths)


def test_a_byte_changed_after_opening_is_noticed(opened):
    public, _truths = opened
    verdict = public / "verdicts/case-002/diagnosis.json"
    flipped(verdict)
    for check in (sealing.check_opened, sealing.seal):
        with pytest.raises(InputError, match=r"verdicts/case-002/diagnosis\.json"):
            check(public)
    (public / "seal.json").unlink()
    with pytest.raises(InputError, match="when the truths were opened"):
        sealing.seal(public)
    flipped(verdict)
    sealing.seal(public)
    sealing.check_opened(public)


def test_a_seal_of_other_verdicts_is_noticed_after_opening(opened):
    public, _ = opened
    flipped(public / "verdicts/case-001/diagnosis.json")
    record = public / "opened" / "opened.json"
    kept = record.read_text()
    record.unlink()
    sealing.seal(public)
    record.write_text(kept)
    with pytest.raises(InputError, match="under which it was opened"):
        sealing.check_opened(public)


def test_an_edited_seal_is_noticed(block):
    public, truths = block
    sealing.seal(public)
    path = public / "seal.json"
    kept = json.loads(path.read_text())
    kept["files"]["verdicts/case-001/diagnosis.json"] = "0" * 64
    path.write_text(json.dumps(kept))
    with pytest.raises(InputError, match=r"seal\.json: seal"):
        sealing.unlock(public, truths)


@pytest.mark.parametrize("part", ["recordings", "queries"])
def test_an_exchanged_recording_is_noticed(block, part):
    public, truths = block
    sealing.seal(public)
    flipped(public / part / "case-002.parquet")
    with pytest.raises(InputError, match=rf"{part}/case-002\.parquet"):
        sealing.unlock(public, truths)
    with pytest.raises(InputError, match=rf"{part}/case-002\.parquet"):
        sealing.seal(public)


def test_an_exchanged_truth_is_noticed(block):
    """Also one that was sealed with the right key for the right case."""
    public, truths = block
    root = sealing.root_of("demo", 5, truths)
    other = sealing.packed({**truth("case-001"), "effects": []}, {"clean_V": np.zeros((4, 3))})
    path = truths / "case-001.sealed"
    path.write_bytes(sealing.seal_truth(root, "demo", "case-001", other))
    sealing.seal(public)
    with pytest.raises(InputError, match=r"case-001\.sealed: truth of case-001"):
        sealing.unlock(public, truths)
    shutil.copy(truths / "case-002.sealed", path)
    with pytest.raises(InputError, match=r"case-001\.sealed: sealed truth"):
        sealing.unlock(public, truths)


def test_a_truth_changed_after_opening_is_noticed(opened):
    public, _ = opened
    path = public / "opened" / "case-003.json"
    path.write_text(path.read_text().replace("offset", "onset_"))
    with pytest.raises(InputError, match="truth of case-003"):
        sealing.check_opened(public)


def test_changed_commitments_unwrap_no_key(block):
    public, truths = block
    path = public / "commitments.json"
    path.write_text(path.read_text() + "\n")
    sealing.seal(public)
    with pytest.raises(InputError, match="wrapped for these commitments"):
        sealing.unlock(public, truths)


def test_nothing_of_a_truth_lies_in_the_clear(block):
    public, truths = block
    kept = b"".join([*files(public).values(), *files(truths).values()])
    root = sealing.root_of("demo", 5, truths)
    for secret in (b"offset", b"effects", root, sealing.derived(root, "key")):
        assert secret not in kept and secret.hex().encode() not in kept


def test_the_same_seed_gives_the_same_bytes(tmp_path):
    first, again = (concealed(tmp_path / name) for name in ("a", "b"))
    assert files(first[0]) == files(again[0]) and files(first[1]) == files(again[1])
    other = concealed(tmp_path / "c", seed=6)
    assert not set(files(other[1]).values()) & set(files(first[1]).values())


def test_the_operating_system_s_root_is_drawn_once_and_then_sealed(tmp_path):
    truths = tmp_path / "truths"
    first = sealing.root_of("final", None, truths)
    assert first == sealing.root_of("final", None, truths)
    assert first != sealing.root_of("final", None, tmp_path / "other")
    assert sorted(f.name for f in truths.iterdir()) == [sealing.ROOT]


def test_a_final_block_is_committed_once(tmp_path):
    public, truths = concealed(tmp_path, None, "final")
    assert not (truths / sealing.ROOT).exists() and sealing.complete(None, truths)
    before = files(tmp_path)
    sealing.commit("final", None, [public / "batches" / "000.json"], public, truths)
    assert files(tmp_path) == before
    sealing.seal(public)
    sealing.unlock(public, truths)
    root = json.loads((public / "opened" / "opened.json").read_text())["root"]
    plain = sealing.packed(truth(CASES[0]), {"clean_V": np.zeros((4, 3))})
    sealed = sealing.seal_truth(bytes.fromhex(root), "final", CASES[0], plain)
    assert sealed == (truths / f"{CASES[0]}.sealed").read_bytes()


@settings(deadline=None, max_examples=25)
@given(
    st.dictionaries(st.text(max_size=5), st.floats(allow_nan=False, allow_infinity=False)),
    st.integers(0, 30_000),
)
def test_packing_keeps_a_truth_and_hides_its_length(content, readings):
    arrays = {"clean_V": np.linspace(0.0, 1.0, readings)}
    plain = sealing.packed(content, arrays)
    assert len(plain) == sealing.TRUTH_BYTES
    text, body = sealing.unpacked(plain)
    assert json.loads(text) == content and plain == sealing.packed(content, arrays)
    assert len(body) >= readings * 8
    sealed = sealing.seal_truth(bytes(32), "demo", "case-001", plain)
    assert len(sealed) == sealing.TRUTH_BYTES + sealing.NONCE_BYTES + sealing.TAG_BYTES


def test_no_two_texts_share_a_nonce():
    root = bytes(range(32))
    texts = [sealing.packed({"n": n}, {}) for n in range(3)]
    sealed = [sealing.seal_truth(root, "demo", c, t) for c in CASES for t in texts]
    assert len({one[: sealing.NONCE_BYTES] for one in sealed}) == 9
