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
    own = path.with_name(f".{ROOT}.{os.getpid()}.part")
    own.write_text(json.dumps({"root": os.urandom(32).hex()}) + "\n", "utf-8")
    try:
        os.link(own, path)  # of several processes the first; none overwrites it
    except FileExistsError:
        pass
    finally:
        own.unlink()
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
    whole = len(text).to_bytes(HEADER) + len(body).to_bytes(HEADER) + text + body
    return whole + bytes(-len(whole) % TRUTH_BYTES)


def unpacked(plain: bytes) -> tuple[bytes, bytes]:
    """The JSON and the NPZ of a packed truth."""
    first, second = (int.from_bytes(plain[k * HEADER : (k + 1) * HEADER]) for k in (0, 1))
    start = 2 * HEADER
    return plain[start : start + first], plain[start + first : start + first + second]


def seal_truth(root: bytes, block: str, case: str, plain: bytes) -> bytes:
    """A packed truth, encrypted: nonce, ciphertext, tag. The nonce follows from root, case and
    plain text, so that no two texts ever share one."""
    nonce = derived(root, "nonce", block, case, hashlib.sha256(plain).hexdigest())[:NONCE_BYTES]
    return nonce + AESGCM(derived(root, "key")).encrypt(nonce, plain, _label(block, case))


def open_truth(key: bytes, block: str, case: str, path: Path) -> bytes:
    """The packed truth in a sealed file. InputError where the key or the case is another's, or the
    file was changed."""
    sealed = path.read_bytes()
    nonce, rest = sealed[:NONCE_BYTES], sealed[NONCE_BYTES:]
    try:
        return AESGCM(key).decrypt(nonce, rest, _label(block, case))
    except (InvalidTag, ValueError) as error:
        expected = f"the truth of {case}, as it was sealed"
        raise InputError(path, "sealed truth", "other bytes", expected) from error


def _label(block: str, case: str) -> bytes:
    return f"{block} {case}".encode()


def salted(salt: str, path: Path) -> str:
    """SHA-256, in hex, of a salt (hex) and a file's bytes."""
    return hashlib.sha256(bytes.fromhex(salt) + path.read_bytes()).hexdigest()


def commitment(root: bytes, case: str, recording: Path, query: Path, plain: bytes) -> dict:
    """What is made public of a case: {recording, query: {salt, sha256}, truth: sha256}; the salt of
    the truth is in it, under lock."""
    made = {}
    for name, path in (("recording", recording), ("query", query)):
        salt = derived(root, "salt", case, name).hex()
        made[name] = {"salt": salt, "sha256": salted(salt, path)}
    return {**made, "truth": hashlib.sha256(plain).hexdigest()}


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
    kept = {
        "block": block,
        "wrapped": keywrap.aes_key_wrap(_wrapping(text.encode()), key).hex(),
        "root": (nonce + AESGCM(key).encrypt(nonce, root, _label(block, ROOT))).hex(),
    }
    _write(public / "commitments.json", text)
    _write(truths / KEY, _json(kept))
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
    for case, made in commitments["cases"].items():
        for name, folder in (("recording", "recordings"), ("query", "queries")):
            file = block / folder / f"{case}.parquet"
            found = salted(made[name]["salt"], file) if file.is_file() else "no such file"
            if found != made[name]["sha256"]:
                raise InputError(file, f"{name} of {case}", found, made[name]["sha256"])
    return commitments


def digests(block: Path) -> dict[str, str]:
    """SHA-256 of commitments.json and of every file that was made of the recordings, by its path
    in the block's folder."""
    files = [block / "commitments.json"]
    for folder in SEALED:
        found = (block / folder).rglob("*")
        files += sorted(f for f in found if f.is_file() and not f.name.startswith("."))
    return {f.relative_to(block).as_posix(): _sha256(f) for f in files}


def seal(block: Path) -> str:
    """Write seal.json over all verdicts and baselines of a block and return the seal.

    Raises InputError where the block has been opened under another seal: who has seen the truths
    seals nothing.
    """
    check_commitments(block)
    files = digests(block)
    made = _seal_of(files)
    opened = block / "opened" / "opened.json"
    if opened.is_file():
        known = json.loads(opened.read_text("utf-8"))
        if known["seal"] != made:
            raise _difference(block, known["files"], files, "when the truths were opened")
    _write(block / "seal.json", _json({"files": files, "seal": made}))
    return made


def check_seal(block: Path) -> str:
    """The seal of a block, all that it is over being as it was sealed, also after opening.

    Raises InputError where there is none, or where a file differs from it by a byte, is missing or
    has been added.
    """
    path = block / "seal.json"
    if not path.is_file():
        raise InputError(path, "file", "no such file", "the seal that `seal_verdicts` makes")
    kept = json.loads(path.read_text("utf-8"))
    if kept["seal"] != _seal_of(kept["files"]):
        raise InputError(path, "seal", kept["seal"], f"{_seal_of(kept['files'])}, of its files")
    found = digests(block)
    if found != kept["files"]:
        raise _difference(block, kept["files"], found, "when it was sealed")
    opened = block / "opened" / "opened.json"
    if opened.is_file():
        known = json.loads(opened.read_text("utf-8"))["seal"]
        if known != kept["seal"]:
            raise InputError(path, "seal", kept["seal"], f"{known}, under which it was opened")
    return kept["seal"]


def _difference(block: Path, before: dict, after: dict, when: str) -> InputError:
    file = min(f for f in {*before, *after} if before.get(f) != after.get(f))
    found, expected = after.get(file, "no such file"), before.get(file, "no such file")
    return InputError(block / file, "sha256", found, f"{expected}, {when}")


def _seal_of(files: dict[str, str]) -> str:
    return hashlib.sha256(_json(files).encode()).hexdigest()


def unlock(block: Path, truths: Path) -> list[str]:
    """Write the truths of a sealed block to its folder `opened`: case-NNN.json and .npz of each,
    and opened.json: {block, seal, files, commitments (their SHA-256), root}. Returns the cases.

    Raises InputError, and opens nothing, where there is no seal, where anything it is over differs
    by a byte, where a recording, query or truth is not the one committed to, and where the key was
    wrapped for other commitments.
    """
    made = check_seal(block)
    commitments = check_commitments(block)
    name = commitments["block"]
    path = truths / KEY
    if not path.is_file():
        raise InputError(path, "file", "no such file", "the key that `conceal` wraps")
    kept = json.loads(path.read_text("utf-8"))
    public = (block / "commitments.json").read_bytes()
    try:
        key = keywrap.aes_key_unwrap(_wrapping(public), bytes.fromhex(kept["wrapped"]))
    except keywrap.InvalidUnwrap as error:
        expected = "one wrapped for these commitments"
        raise InputError(path, "key wrapped", "another's", expected) from error
    plain = {}
    for case, promised in commitments["cases"].items():
        sealed = truths / f"{case}.sealed"
        plain[case] = open_truth(key, name, case, sealed)
        found = hashlib.sha256(plain[case]).hexdigest()
        if found != promised["truth"]:
            raise InputError(sealed, f"truth of {case}", found, promised["truth"])
    root = bytes.fromhex(kept["root"])
    root = AESGCM(key).decrypt(root[:NONCE_BYTES], root[NONCE_BYTES:], _label(name, ROOT))
    for case, truth in plain.items():
        for suffix, part in zip(("json", "npz"), unpacked(truth), strict=True):
            with atomic_path(block / "opened" / f"{case}.{suffix}") as temporary:
                temporary.write_bytes(part)
    record = {
        "block": name,
        "seal": made,
        "files": digests(block),
        "commitments": hashlib.sha256(public).hexdigest(),
        "root": root.hex(),
    }
    _write(block / "opened" / "opened.json", _json(record))
    return list(plain)


def check_opened(block: Path) -> str:
    """The seal of an opened block: verdicts as they were sealed, recordings and truths as they were
    committed to. Raises InputError for the first that is not."""
    made = check_seal(block)
    for case, promised in check_commitments(block)["cases"].items():
        text, body = (block / "opened" / f"{case}.{suffix}" for suffix in ("json", "npz"))
        for path in (text, body):
            if not path.is_file():
                raise InputError(path, "file", "no such file", "the truth that `open` writes")
        found = hashlib.sha256(_padded(text.read_bytes(), body.read_bytes())).hexdigest()
        if found != promised["truth"]:
            raise InputError(text, f"truth of {case}", found, promised["truth"])
    return made


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _json(value: dict) -> str:
    return json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _write(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, "utf-8")
