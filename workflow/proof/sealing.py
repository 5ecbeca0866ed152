"""Truths under lock, promises that they stay what they are, and the seal over all verdicts.

A truth is encrypted when it is drawn (AES-GCM, NIST SP 800-38D), and before anything is diagnosed
`commitments.json` says the salted SHA-256 of every recording, query and truth. `seal.json` says
the SHA-256 of every file that was made of them; only against it does `unlock` give the truths.

What that is good for: nothing that a diagnosis can read holds a truth; no truth can be exchanged
after the verdicts are known, nor a verdict or a recording after the truths are, without its being
seen. What it is not: a lock against the owner of the machine. The key lies beside the truths,
wrapped (RFC 3394) under what the public commitments derive, so that changed commitments open
nothing; that `unlock` asks for the seal before it unwraps is its code, and other code could do
without. A block whose seed stands in the configuration can be drawn again by anybody. The final
block's root is the operating system's random number and lies encrypted with its truths: whoever
wants more than order and evidence keeps its folder of truths on another machine until the seal is
published.
"""

import hashlib
import hmac
import io
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives import keywrap
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from eitskin.atomic import atomic_path
from eitskin.errors import InputError

TRUTH_BYTES = 2**19  # every sealed truth is a multiple of it long
NONCE_BYTES, TAG_BYTES = 12, 16
HEADER = 8  # bytes that say how long the JSON part is, and the arrays
ROOT = "root.json"  # there only while a block with a random root is being concealed
KEY = "key.json"
SEALED = ("verdicts", "baselines")  # folders of a block that the seal is over


def derived(root: bytes, *words: str) -> bytes:
    """32 bytes that follow from a block's root for one purpose, HMAC-SHA256."""
    return hmac.digest(root, "\0".join(words).encode(), "sha256")


def root_of(block: str, seed: int | None, truths: Path) -> bytes:
    """A block's root, 32 bytes, from which all that is drawn for it follows.

    seed None: the operating system's random number, kept in `truths` until the block is committed.
    """
    if seed is not None:
        return hashlib.sha256(f"eitskin concealed {block} {seed}".encode()).digest()
    path = truths / ROOT
    truths.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{ROOT}.{os.getpid()}.part")
    draft.write_text(json.dumps({"root": os.urandom(32).hex()}) + "\n", "utf-8")
    try:
        os.link(draft, path)  # of several processes the first; none overwrites it
    except FileExistsError:
        pass
    finally:
        draft.unlink()
    return bytes.fromhex(json.loads(path.read_text("utf-8"))["root"])


def packed(truth: dict, arrays: dict[str, np.ndarray]) -> bytes:
    """A truth as one text of bytes, padded: lengths, JSON, NPZ. The same bytes for the same truth;
    every length that occurs is filled up to the same multiple."""
    text = json.dumps(truth, sort_keys=True, ensure_ascii=False, allow_nan=False).encode()
    stream = io.BytesIO()
    in_order: dict[str, Any] = {name: arrays[name] for name in sorted(arrays)}
    np.savez(stream, **in_order)
    return _padded(text, stream.getvalue())


def _padded(text: bytes, body: bytes) -> bytes:
    content = len(text).to_bytes(HEADER) + len(body).to_bytes(HEADER) + text + body
    return content + bytes(-len(content) % TRUTH_BYTES)


def unpacked(plain: bytes) -> tuple[bytes, bytes]:
    """The JSON and the NPZ of a packed truth."""
    text_size, body_size = (int.from_bytes(plain[k * HEADER : (k + 1) * HEADER]) for k in (0, 1))
    text, body = plain[2 * HEADER :][:text_size], plain[2 * HEADER + text_size :][:body_size]
    return text, body


def seal_truth(root: bytes, block: str, case: str, plain: bytes) -> bytes:
    """A packed truth, encrypted: nonce, ciphertext, tag. The nonce follows from root, case and
    plain text, so that no two texts ever share one."""
    nonce = derived(root, "nonce", block, case, hashlib.sha256(plain).hexdigest())[:NONCE_BYTES]
    return nonce + AESGCM(derived(root, "key")).encrypt(nonce, plain, _label(block, case))


def open_truth(key: bytes, block: str, case: str, path: Path) -> bytes:
    """The packed truth in a sealed file. InputError where the key or the case is another's, or the
    file was changed."""
    sealed = path.read_bytes()
    nonce, ciphertext = sealed[:NONCE_BYTES], sealed[NONCE_BYTES:]
    try:
        return AESGCM(key).decrypt(nonce, ciphertext, _label(block, case))
    except (InvalidTag, ValueError) as error:
        expected = f"the truth of {case}, as it was sealed"
        raise InputError(path, "sealed truth", "other bytes", expected) from error


def _label(block: str, case: str) -> bytes:
    return f"{block} {case}".encode()


def salted(salt: str, path: Path) -> str:
    """SHA-256, in hex, of a salt (hex) and a file's bytes."""
    return hashlib.sha256(bytes.fromhex(salt) + path.read_bytes()).hexdigest()


def commitment(root: bytes, case: str, files: dict[str, Path], plain: bytes) -> dict:
    """What is made public of a case, by the names of its files, recording and query: {salt, sha256}
    of each, and truth: sha256; the salt of the truth is in it, under lock."""
    digests = {}
    for name, path in files.items():
        salt = derived(root, "salt", case, name).hex()
        digests[name] = {"salt": salt, "sha256": salted(salt, path)}
    return {**digests, "truth": hashlib.sha256(plain).hexdigest()}


def complete(seed: int | None, truths: Path) -> bool:
    """Whether a block with a random root (seed None) is drawn and committed: nothing of it is ever
    drawn again."""
    return seed is None and (truths / KEY).is_file()


def commit(
    block: str, seed: int | None, batches: Iterable[str | Path], public: Path, truths: Path
) -> None:
    """Write commitments.json from those of the batches, and key.json, which keeps the truths' key
    and the root; after that a random root stands nowhere in the clear."""
    if complete(seed, truths):
        check_commitments(public)
        return
    root = root_of(block, seed, truths)
    cases: dict[str, dict] = {}
    for batch in batches:
        cases |= json.loads(Path(batch).read_text("utf-8"))
    text = _json({"block": block, "digest": "sha256(salt + file)", "cases": cases})
    key = derived(root, "key")
    nonce = derived(root, "nonce", block, ROOT)[:NONCE_BYTES]
    key_record = {
        "block": block,
        "wrapped": keywrap.aes_key_wrap(_wrapping(text.encode()), key).hex(),
        "root": (nonce + AESGCM(key).encrypt(nonce, root, _label(block, ROOT))).hex(),
    }
    _write(public / "commitments.json", text)
    _write(truths / KEY, _json(key_record))
    (truths / ROOT).unlink(missing_ok=True)


def _wrapping(commitments: bytes) -> bytes:
    return hashlib.sha256(b"eitskin wrapping key" + commitments).digest()


def check_commitments(block: Path) -> dict:
    """commitments.json of a block, its recordings and queries being those that it names; InputError
    where one is not."""
    path = block / "commitments.json"
    if not path.is_file():
        raise InputError(path, "file", "no such file", "the commitments that `conceal` makes")
    commitments = json.loads(path.read_text("utf-8"))
    for case, promise in commitments["cases"].items():
        for name, folder in (("recording", "recordings"), ("query", "queries")):
            file = block / folder / f"{case}.parquet"
            digest = salted(promise[name]["salt"], file) if file.is_file() else "no such file"
            if digest != promise[name]["sha256"]:
                raise InputError(file, f"{name} of {case}", digest, promise[name]["sha256"])
    return commitments


def digests(block: Path) -> dict[str, str]:
    """SHA-256 of commitments.json and of every file that was made of the recordings, by its path
    in the block's folder."""
    files = [block / "commitments.json"]
    for folder in SEALED:
        paths = (block / folder).rglob("*")
        files += sorted(f for f in paths if f.is_file() and not f.name.startswith("."))
    return {f.relative_to(block).as_posix(): _sha256(f) for f in files}


def seal(block: Path) -> str:
    """Write seal.json over all verdicts and baselines of a block and return the seal.

    Raises InputError where the block has been opened under another seal: who has seen the truths
    seals nothing.
    """
    check_commitments(block)
    files = digests(block)
    block_seal = _seal_of(files)
    opened = block / "opened" / "opened.json"
    if opened.is_file():
        opened_record = json.loads(opened.read_text("utf-8"))
        if opened_record["seal"] != block_seal:
            raise _difference(block, opened_record["files"], files, "when the truths were opened")
    _write(block / "seal.json", _json({"files": files, "seal": block_seal}))
    return block_seal


def check_seal(block: Path) -> str:
    """The seal of a block, all that it is over being as it was sealed, also after opening.

    Raises InputError where there is none, or where a file differs from it by a byte, is missing or
    has been added.
    """
    path = block / "seal.json"
    if not path.is_file():
        raise InputError(path, "file", "no such file", "the seal that `seal_verdicts` makes")
    record = json.loads(path.read_text("utf-8"))
    block_seal, files = record["seal"], _seal_of(record["files"])
    if block_seal != files:
        raise InputError(path, "seal", block_seal, f"{files}, of its files")
    present = digests(block)
    if present != record["files"]:
        raise _difference(block, record["files"], present, "when it was sealed")
    opened = block / "opened" / "opened.json"
    if opened.is_file():
        opened_seal = json.loads(opened.read_text("utf-8"))["seal"]
        if opened_seal != block_seal:
            raise InputError(path, "seal", block_seal, f"{opened_seal}, under which it was opened")
    return block_seal


def _difference(block: Path, expected: dict, present: dict, moment: str) -> InputError:
    absent = "no such file"
    file = min(f for f in {*expected, *present} if expected.get(f) != present.get(f))
    promised = f"{expected.get(file, absent)}, {moment}"
    return InputError(block / file, "sha256", present.get(file, absent), promised)


def _seal_of(files: dict[str, str]) -> str:
    return hashlib.sha256(_json(files).encode()).hexdigest()


def unlock(block: Path, truths: Path) -> list[str]:
    """Write the truths of a sealed block to its folder `opened`: case-NNN.json and .npz of each,
    and opened.json: {block, seal, files, commitments (their SHA-256), root}. Returns the cases.

    Raises InputError, and opens nothing, where there is no seal, where anything it is over differs
    by a byte, where a recording, query or truth is not the one committed to, and where the key was
    wrapped for other commitments.
    """
    block_seal = check_seal(block)
    commitments = check_commitments(block)
    name = commitments["block"]
    path = truths / KEY
    if not path.is_file():
        raise InputError(path, "file", "no such file", "the key that `conceal` wraps")
    key_record = json.loads(path.read_text("utf-8"))
    public = (block / "commitments.json").read_bytes()
    try:
        key = keywrap.aes_key_unwrap(_wrapping(public), bytes.fromhex(key_record["wrapped"]))
    except keywrap.InvalidUnwrap as error:
        expected = "one wrapped for these commitments"
        raise InputError(path, "key wrapped", "another's", expected) from error
    plain = {}
    for case, promised in commitments["cases"].items():
        sealed = truths / f"{case}.sealed"
        plain[case] = open_truth(key, name, case, sealed)
        digest = hashlib.sha256(plain[case]).hexdigest()
        if digest != promised["truth"]:
            raise InputError(sealed, f"truth of {case}", digest, promised["truth"])
    root = bytes.fromhex(key_record["root"])
    root = AESGCM(key).decrypt(root[:NONCE_BYTES], root[NONCE_BYTES:], _label(name, ROOT))
    for case, truth in plain.items():
        for suffix, part in zip(("json", "npz"), unpacked(truth), strict=True):
            with atomic_path(block / "opened" / f"{case}.{suffix}") as temporary:
                temporary.write_bytes(part)
    record = {
        "block": name,
        "seal": block_seal,
        "files": digests(block),
        "commitments": hashlib.sha256(public).hexdigest(),
        "root": root.hex(),
    }
    _write(block / "opened" / "opened.json", _json(record))
    return list(plain)


def check_opened(block: Path) -> str:
    """The seal of an opened block: verdicts as they were sealed, recordings and truths as they were
    committed to. Raises InputError for the first that is not."""
    block_seal = check_seal(block)
    for case, promised in check_commitments(block)["cases"].items():
        text, body = (block / "opened" / f"{case}.{suffix}" for suffix in ("json", "npz"))
        for path in (text, body):
            if not path.is_file():
                raise InputError(path, "file", "no such file", "the truth that `open` writes")
        digest = hashlib.sha256(_padded(text.read_bytes(), body.read_bytes())).hexdigest()
        if digest != promised["truth"]:
            raise InputError(text, f"truth of {case}", digest, promised["truth"])
    return block_seal


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _json(value: dict) -> str:
    return json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, "utf-8")
