"""The fingerprint follows code through imports, and nothing else."""

import pytest

from eitskin import fingerprint as subject

MODULES = {
    "__init__.py": "",
    "forward.py": '"""Solve."""\n\nfrom pkg import mesh\n\n\ndef solve():\n    """A solve."""\n'
    "    from .effects import crosstalk\n\n    return mesh, crosstalk\n",
    "mesh.py": "import numpy\n\nSIZE = 1\n",
    "plots.py": "COLOUR = 'red'\n",
    "effects/__init__.py": "from ..protocol import PAIRS\n",
    "effects/crosstalk.py": "from . import gains\n",
    "effects/gains.py": "GAIN = 1\n",
    "protocol.py": "PAIRS = 208\n",
}


@pytest.fixture
def package(tmp_path, monkeypatch):
    folder = tmp_path / "pkg"
    for name, code in MODULES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(code)
    monkeypatch.setattr(subject, "PACKAGE", folder)
    return folder


@pytest.mark.parametrize(
    "module", ["__init__.py", "mesh.py", "effects/__init__.py", "effects/gains.py", "protocol.py"]
)
def test_code_of_a_dependency_counts(package, module):
    before = subject.fingerprint("pkg.forward")
    (package / module).write_text((package / module).read_text() + "CHANGED = True\n")
    assert subject.fingerprint("pkg.forward") != before


@pytest.mark.parametrize("module", sorted(MODULES))
def test_comments_docstrings_and_layout_do_not_count(package, module):
    before = subject.fingerprint("pkg.forward")
    code = (package / module).read_text().replace("A solve.", "Another text.")
    docstring = '"""Another docstring."""\n' if not code.startswith('"""') else ""
    (package / module).write_text(f"# A comment.\n{docstring}\n\n{code}\n\n# The end.\n")
    assert subject.fingerprint("pkg.forward") == before


def test_a_string_that_is_no_docstring_counts(package):
    before = subject.fingerprint("pkg.plots")
    (package / "plots.py").write_text("COLOUR = 'blue'\n")
    assert subject.fingerprint("pkg.plots") != before


def test_unrelated_modules_do_not_count(package):
    before = subject.fingerprint("pkg.forward")
    (package / "plots.py").write_text("COLOUR = 'blue'\n")
    (package / "new.py").write_text("from pkg import forward\n")
    assert subject.fingerprint("pkg.forward") == before


def test_a_package_counts_with_all_its_modules(package):
    before = subject.fingerprint("pkg.forward")
    (package / "effects" / "drift.py").write_text("RATE = 1\n")
    assert subject.fingerprint("pkg.forward") != before


def test_the_place_of_the_package_does_not_count(package, tmp_path, monkeypatch):
    before = subject.fingerprint("pkg.forward")
    moved = tmp_path / "elsewhere" / "pkg"
    moved.parent.mkdir()
    package.rename(moved)
    monkeypatch.setattr(subject, "PACKAGE", moved)
    assert subject.fingerprint("pkg.forward") == before


def test_an_unknown_module_is_refused(package):
    with pytest.raises(ModuleNotFoundError, match=r"pkg\.no_such_module"):
        subject.fingerprint("pkg.no_such_module")


def test_the_package_itself_can_be_read():
    assert len(subject.fingerprint("eitskin.configuration")) == 64
