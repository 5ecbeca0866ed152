"""Hashes of the code behind a workflow's script, comments aside: whether to run it again."""

import ast
import hashlib
import json
import platform
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from eitskin.atomic import atomic_path

HOUSE = Path(__file__).parents[1]
FINDS_BY_NAME = {  # packages with modules that no import statement names
    "eitskin.effects",
    "eitskin.learn.models",
    "eitskin.data.importers",
}
FINGERPRINTED: dict[str, dict[str, str]] = {}
Parsed = tuple[str, tuple[str, ...]]  # digest of code, and the names that it imports
# By the digest of a file's bytes: what a process has parsed, and what others before it had.
PARSED: dict[str, Parsed] = {}
RECALLED: dict[str, Parsed] = {}
# What a product's content does not follow: refusals, how a file is written, on how many cores.
IMMATERIAL = {"eitskin.errors", "eitskin.atomic", "eitskin.cores", "eitskin.provenance"}
# Numbers as text: what effects and physics say with them is a product of those alone who say it,
# and they import it too.
WORDS, WORDED = "eitskin.quantities", ("eitskin.effects", "eitskin.physics")


def fingerprint(
    script: str, named_modules: Iterable[str] | None = None, files: Iterable[str | Path] = ()
) -> str:
    """SHA-256, in hex, of the syntax trees of scripts/`script`.py and of all that it `reached`.

    named_modules: modules that the script's work imports by name: effects, models and formats in
    use. files: other files of the workflow that it reads; their bytes count, as modification times
    are all new in a fresh clone. Comments, docstrings and layout do not count. Raises ValueError
    unless `named_modules` is given exactly where the script reaches a package of FINDS_BY_NAME.
    """
    names = None if named_modules is None else tuple(sorted(set(named_modules)))
    return _fingerprint(script, names, tuple(map(str, files)))


@cache
def _fingerprint(script: str, named_modules: tuple[str, ...] | None, files: tuple[str, ...]) -> str:
    digest = hashlib.sha256()
    modules = reached(script, named_modules)
    for name, digest_text in sorted(modules.items()):
        digest.update(f"{name}\n{digest_text}\n".encode())
    for file in files:
        digest.update(hashlib.sha256(Path(file).read_bytes()).digest())
    FINGERPRINTED[digest.hexdigest()] = modules
    return digest.hexdigest()


def fingerprinted(fingerprint: str) -> dict[str, str]:
    """What a fingerprint of this process is of, as `reached`."""
    return FINGERPRINTED[fingerprint]


def digest_of(name: str) -> str | None:
    """The digest of a script or a module as it is now, by its name in `reached`; None for one that
    is not there any more."""
    file = HOUSE / f"{name}.py" if name.startswith("scripts/") else _file(name)
    return None if file is None or not file.is_file() else _parsed(file)[0]


def reached(script: str, named_modules: Iterable[str] | None = None) -> dict[str, str]:
    """Digests by name: of the script and of the modules that its import statements lead to, also
    those inside functions, with the packages that contain them. Nothing is imported.

    Raises as `fingerprint`, and ModuleNotFoundError for a missing script or module.
    """
    file = HOUSE / "scripts" / f"{script}.py"
    if not file.is_file():
        raise ModuleNotFoundError(f"no script {file}", name=script)
    digest, imports = _parsed(file)
    modules = set(_closure(imports))
    finds = sorted(FINDS_BY_NAME & modules)
    if (named_modules is None) == bool(finds):
        message = f"which does it find by {', '.join(finds)}" if finds else "it finds none by name"
        raise ValueError(f"script {script}: {message}")
    for name in named_modules or ():
        if _file(name) is None:
            raise ModuleNotFoundError(f"no module {name} in {HOUSE}", name=name)
        modules |= _closure((name,))
    return {f"scripts/{script}": digest, **{name: _parsed(_file(name))[0] for name in modules}}


@cache
def _closure(names: tuple[str, ...]) -> frozenset[str]:
    """All modules of the workflow that names lead to, with these and their packages."""
    waiting = list(names)
    visited: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in visited | IMMATERIAL or (file := _file(name)) is None:
            continue
        visited.add(name)
        worded = name.startswith(WORDED)
        waiting += [other for other in _parsed(file)[1] if not (worded and other == WORDS)]
        waiting += _within(name)
    return frozenset(visited)


def imported_names(file: Path) -> tuple[str, ...]:
    """Every name that an import statement of a file may load, also those inside functions: modules,
    and names imported from them."""
    return _parsed(file)[1]


def _within(name: str) -> list[str]:
    return [name.rpartition(".")[0]] if "." in name else []


@cache
def _file(name: str) -> Path | None:
    """The file of a module of the house, or None for anything else."""
    parts = name.split(".")
    if not (HOUSE / parts[0] / "__init__.py").is_file():
        return None
    base = HOUSE.joinpath(*parts)
    return next((f for f in (base / "__init__.py", base.with_suffix(".py")) if f.is_file()), None)


@cache
def _parsed(file: Path) -> Parsed:
    """Digest of the code of a file, and the names that it imports; cached."""
    content = file.read_bytes()
    key = hashlib.sha256(content).hexdigest()
    if key not in RECALLED:
        tree = ast.parse(content, str(file))
        names = tuple(_imports(tree))
        digest = hashlib.sha256(_dumped(_without_docstrings(tree)).encode()).hexdigest()
        RECALLED[key] = digest, names
    PARSED[key] = RECALLED[key]
    return PARSED[key]


def recall(path: str | Path) -> None:
    """Take over what a process before this one has parsed, from the file that `keep` wrote; to
    parse all modules takes longer than the rest of a start. Nothing from a file of another Python
    or of another version of this module, as both may give other digests, nor from no file or
    another's."""
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        if content["by"] == _parser():
            parsed = {key: (digest, tuple(names)) for key, digest, names in content["parsed"]}
            RECALLED.update(parsed)
    except (OSError, ValueError, KeyError, TypeError):
        return


def keep(path: str | Path) -> None:
    """Write what this process has parsed or recalled and used, where that is other than the file
    has."""
    parsed = [[key, digest, list(names)] for key, (digest, names) in sorted(PARSED.items())]
    text = json.dumps({"by": _parser(), "parsed": parsed}) + "\n"
    if not Path(path).exists() or Path(path).read_text(encoding="utf-8") != text:
        with atomic_path(path) as temporary:
            temporary.write_text(text, encoding="utf-8")


def _parser() -> str:
    """What digests depend on besides code."""
    own = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    return f"{platform.python_version()} {own}"


def _dumped(node: object) -> str:
    """`ast.dump` of a node, a list of nodes or a value, four times as fast: every start of the
    workflow hashes every module."""
    kind = type(node)
    if isinstance(node, ast.Name):
        return f"Name(id={node.id!r}, ctx={type(node.ctx).__name__}())"
    if isinstance(node, ast.AST):
        fields = []
        for name in node._fields:
            value = getattr(node, name, None)
            if value is not None or getattr(kind, name, ...) is not None:
                fields.append(f"{name}={_dumped(value)}")
        return f"{kind.__name__}({', '.join(fields)})"
    if isinstance(node, list):
        return f"[{', '.join([_dumped(element) for element in node])}]"
    return repr(node)


def _statements(tree: ast.Module) -> Iterator[ast.AST]:
    """The tree and every statement in it, without expressions, which are most of a full walk."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for block in ("body", "orelse", "handlers", "finalbody", "cases"):
            waiting.extend(getattr(node, block, ()))


def _imports(tree: ast.Module) -> list[str]:
    """Every name that an import statement may load: modules, and names imported from them."""
    names: list[str] = []
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            names.extend(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.append(node.module)
            names.extend(f"{node.module}.{alias.name}" for alias in node.names)
    return names


def _without_docstrings(tree: ast.Module) -> ast.Module:
    """The tree, emptied of docstrings in place."""
    for node in _statements(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            statement = node.body[0] if node.body else None
            if (
                isinstance(statement, ast.Expr)
                and isinstance(statement.value, ast.Constant)
                and isinstance(statement.value.value, str)
            ):
                node.body = node.body[1:]
    return tree
