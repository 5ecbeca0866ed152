"""What a module's code says, whatever its comments: the workflow's reason to run a rule again."""

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parent


def fingerprint(module: str) -> str:
    """SHA-256, in hex, of the syntax trees of `module` and of all it imports from this package and
    those beside it.

    Follows import statements, also those inside functions, without importing anything; a package
    below the first level counts with all its modules, which it may find by name. Comments,
    docstrings and layout do not count; nor does package data. Raises ModuleNotFoundError for a
    module that is part of none of them.
    """
    digest = hashlib.sha256()
    for name, tree in sorted(_closure(module).items()):
        digest.update(f"{name}\n{tree}\n".encode())
    return digest.hexdigest()


def _closure(module: str) -> dict[str, str]:
    """What code says by module name: `module`, the packages that hold it, and all their imports."""
    said: dict[str, str] = {}
    waiting, met = [module], set()
    if _file(module) is None:
        raise ModuleNotFoundError(f"no module {module} in {PACKAGE.parent}", name=module)
    while waiting:
        name = waiting.pop()
        file = None if name in met else _file(name)
        met.add(name)
        if file is None:
            continue
        package = name if file.name == "__init__.py" else name.rpartition(".")[0]
        said[name], imports = _parsed(file.read_text(encoding="utf-8"), str(file), package)
        waiting.extend(imports)
        waiting.append(name.rpartition(".")[0])
        if package == name and "." in name:
            waiting.extend(f"{name}.{entry.stem}" for entry in file.parent.glob("[!_]*.py"))
    return said


@cache
def _parsed(code: str, file: str, package: str) -> tuple[str, tuple[str, ...]]:
    """What a module's code says, and the names it imports."""
    tree = ast.parse(code, file)
    names = tuple(_imports(tree, package))
    return hashlib.sha256(ast.dump(_without_docstrings(tree)).encode()).hexdigest(), names


def _file(name: str) -> Path | None:
    """The file of a module of these packages, or None for anything else."""
    parts = name.split(".")
    if not (PACKAGE.parent / parts[0] / "__init__.py").is_file():
        return None
    base = PACKAGE.parent.joinpath(*parts)
    return next((f for f in (base / "__init__.py", base.with_suffix(".py")) if f.is_file()), None)


def _statements(tree: ast.Module) -> Iterator[ast.AST]:
    """The tree and every statement in it; what they are made of is left out, and most of a walk."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for block in ("body", "orelse", "handlers", "finalbody", "cases"):
            waiting.extend(getattr(node, block, ()))


def _imports(tree: ast.Module, package: str) -> list[str]:
    """Every name that an import statement may load: modules, and what is taken from them."""
    names = []
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            names.extend(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) + 1 - node.level]
            source = ".".join(parents if node.level else [])
            source = ".".join(filter(None, [source, node.module]))
            names.append(source)
            names.extend(f"{source}.{alias.name}" for alias in node.names)
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
