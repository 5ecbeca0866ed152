"""What the code of a workflow's script says, whatever its comments: the reason to run it again."""

import ast
import hashlib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

HOUSE = Path(__file__).parents[1]
FINDS_BY_NAME = {  # what has modules that no import statement names
    "eitskin.effects",
    "eitskin.learn.models",
    "eitskin.data.importers",
}


def fingerprint(
    script: str, found: Iterable[str] | None = None, files: Iterable[str | Path] = ()
) -> str:
    """SHA-256, in hex, of the syntax trees of scripts/`script`.py and of all that it `reached`.

    found: modules that the script's work finds by name: effects, models and formats in use. files:
    what else of the workflow it reads, byte by byte: their times say nothing, as a fresh clone has
    all of them new. Comments, docstrings and layout do not count. Raises ValueError unless `found`
    is given where the script reaches what finds modules by name, and only there.
    """
    digest = hashlib.sha256()
    for name, said in sorted(reached(script, found).items()):
        digest.update(f"{name}\n{said}\n".encode())
    for file in files:
        digest.update(hashlib.sha256(Path(file).read_bytes()).digest())
    return digest.hexdigest()


def reached(script: str, found: Iterable[str] | None = None) -> dict[str, str]:
    """What code says by name: the script, and modules that import statements lead to, also those
    inside functions, with the packages that hold them; nothing is imported for it.

    Raises as `fingerprint`, and ModuleNotFoundError for what is not there.
    """
    file = HOUSE / "scripts" / f"{script}.py"
    if not file.is_file():
        raise ModuleNotFoundError(f"no script {file}", name=script)
    said, imports = _parsed(file)
    modules = set(_closure(imports))
    finds = sorted(FINDS_BY_NAME & modules)
    if (found is None) == bool(finds):
        which = f"which does it find by {', '.join(finds)}" if finds else "it finds none by name"
        raise ValueError(f"script {script}: {which}")
    for name in found or ():
        if _file(name) is None:
            raise ModuleNotFoundError(f"no module {name} in {HOUSE}", name=name)
        modules |= _closure((name,))
    return {f"scripts/{script}": said, **{name: _parsed(_file(name))[0] for name in modules}}


@cache
def _closure(names: tuple[str, ...]) -> frozenset[str]:
    """All modules of the house that names lead to, with these and the packages that hold them."""
    waiting, met = list(names), set()
    while waiting:
        name = waiting.pop()
        if name in met or (file := _file(name)) is None:
            continue
        met.add(name)
        waiting += [*_parsed(file)[1], *_within(name)]
    return frozenset(met)


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
def _parsed(file: Path) -> tuple[str, tuple[str, ...]]:
    """What the code of a file says, and the names that it imports; read once a process."""
    tree = ast.parse(file.read_text(encoding="utf-8"), str(file))
    names = tuple(_imports(tree))
    return hashlib.sha256(_told(_without_docstrings(tree)).encode()).hexdigest(), names


def _told(node: object) -> str:
    """`ast.dump` of a node, of a list of nodes or of a value, four times as fast: every start of
    the workflow tells of every module."""
    kind = type(node)
    if isinstance(node, ast.Name):
        return f"Name(id={node.id!r}, ctx={type(node.ctx).__name__}())"
    if isinstance(node, ast.AST):
        fields = []
        for name in node._fields:
            value = getattr(node, name, None)
            if value is not None or getattr(kind, name, ...) is not None:
                fields.append(f"{name}={_told(value)}")
        return f"{kind.__name__}({', '.join(fields)})"
    if isinstance(node, list):
        return f"[{', '.join([_told(one) for one in node])}]"
    return repr(node)


def _statements(tree: ast.Module) -> Iterator[ast.AST]:
    """The tree and every statement in it; what they are made of is left out, and most of a walk."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for block in ("body", "orelse", "handlers", "finalbody", "cases"):
            waiting.extend(getattr(node, block, ()))


def _imports(tree: ast.Module) -> list[str]:
    """Every name that an import statement may load: modules, and what is taken from them."""
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
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                node.body = node.body[1:]
    return tree
