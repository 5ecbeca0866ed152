"""A fingerprint follows code from a script through its imports, and nothing else."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from eitskin import fingerprint as subject
from eitskin.data import importers
from eitskin.effects import catalogue_names, modules
from eitskin.learn import models

ROOT = Path(__file__).parents[3]
SCRIPTS = sorted(path.stem for path in (ROOT / "workflow" / "scripts").glob("*.py"))
FILES = {
    "scripts/solve.py": '"""Solve."""\n\nfrom pkg import forward\n\nforward.solve()\n',
    "scripts/press.py": "from pkg.touch import press\nfrom eitskin.effects import EFFECTS\n",
    "pkg/__init__.py": "",
    "pkg/forward.py": '"""Solve."""\n\nfrom pkg import mesh\n\n\ndef solve():\n    """A solve."""\n'
    "    from pkg.sites import all_sites\n\n    return mesh, all_sites\n",
    "pkg/mesh.py": "import numpy\n\nSIZE = 1\n",
    "pkg/plots.py": "COLOUR = 'red'\n",
    "pkg/sites/__init__.py": "from pkg.protocol import PAIRS\n\nall_sites = PAIRS\n",
    "pkg/sites/ring.py": "STEP = 1\n",
    "pkg/protocol.py": "PAIRS = 208\n",
    "pkg/touch.py": "def press():\n    return 1\n",
    "eitskin/__init__.py": "",
    "eitskin/effects/__init__.py": "EFFECTS = {}\n",
    "eitskin/effects/gain.py": "from pkg.mesh import SIZE\n\nGAIN = 1\n",
    "eitskin/effects/drift.py": "RATE = 1\n",
}
REACHED = [
    "scripts/solve.py",
    "pkg/__init__.py",
    "pkg/forward.py",
    "pkg/mesh.py",
    "pkg/sites/__init__.py",
    "pkg/protocol.py",
]
DRIFT = ["eitskin.effects.drift"]


@pytest.fixture
def house(tmp_path, monkeypatch):
    """A small house of its own, read anew by `taken`."""
    for name, code in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(code)
    monkeypatch.setattr(subject, "HOUSE", tmp_path)
    yield tmp_path
    forget()


def forget():
    """What a process has read."""
    for known in (subject._parsed, subject._file, subject._closure, subject._fingerprint):
        known.cache_clear()
    for known in (subject.PARSED, subject.RECALLED):
        known.clear()


def taken(script="solve", found=None):
    """The fingerprint as another process would take it."""
    forget()
    return subject.fingerprint(script, found)


def append(path, text):
    path.write_text(path.read_text() + text)


@pytest.mark.parametrize("file", sorted(FILES))
def test_a_statement_counts_where_the_script_reaches_it_and_nowhere_else(house, file):
    before = taken()
    append(house / file, "CHANGED = True\n")
    assert (taken() != before) == (file in REACHED)


@pytest.mark.parametrize("file", sorted(FILES))
def test_comments_docstrings_and_layout_do_not_count(house, file):
    before = taken()
    code = FILES[file].replace("A solve.", "Another text.")
    docstring = "" if code.startswith('"""') else '"""A docstring."""\n'
    (house / file).write_text(f"# A comment.\n{docstring}\n\n{code}\n\n# The end.\n")
    assert taken() == before


def test_a_string_that_is_no_docstring_counts(house):
    before = taken()
    (house / "pkg/mesh.py").write_text("import numpy\n\nSIZE = 'one'\n")
    assert taken() != before


@pytest.mark.parametrize(
    ("file", "counts"),
    [
        ("eitskin/effects/drift.py", True),
        ("eitskin/effects/gain.py", False),
        ("eitskin/effects/__init__.py", True),
        ("pkg/mesh.py", False),
        ("pkg/touch.py", True),
    ],
)
def test_effects_count_that_are_in_use_with_what_they_import(house, file, counts):
    before = taken("press", DRIFT)
    append(house / file, "CHANGED = True\n")
    assert (taken("press", DRIFT) != before) == counts
    with_gain = taken("press", ["eitskin.effects.gain"])
    append(house / "pkg/mesh.py", "AGAIN = True\n")
    assert taken("press", ["eitskin.effects.gain"]) != with_gain


def test_who_reaches_the_effects_says_which_it_uses_and_nobody_else(house):
    with pytest.raises(ValueError, match=r"which does it find by eitskin\.effects"):
        taken("press")
    with pytest.raises(ValueError, match="it finds none by name"):
        taken("solve", DRIFT)


def test_the_place_of_the_house_does_not_count(house, tmp_path_factory, monkeypatch):
    before = taken()
    moved = tmp_path_factory.mktemp("elsewhere") / "house"
    house.rename(moved)
    monkeypatch.setattr(subject, "HOUSE", moved)
    assert taken() == before


def test_what_is_not_there_is_refused(house):
    with pytest.raises(ModuleNotFoundError, match="no_such_script"):
        taken("no_such_script")
    with pytest.raises(ModuleNotFoundError, match=r"eitskin\.effects\.no_such"):
        taken("press", ["eitskin.effects.no_such"])


def test_what_another_process_has_parsed_is_known_by_its_bytes(house, monkeypatch):
    file = house / "parsed.json"
    before = taken()
    subject.keep(file)
    with monkeypatch.context() as context:
        context.setattr(subject.ast, "parse", None)
        forget()
        subject.recall(file)
        assert subject.fingerprint("solve") == before
    append(house / "pkg/mesh.py", "CHANGED = True\n")
    forget()
    subject.recall(file)
    other = subject.fingerprint("solve")
    subject.keep(file)
    assert other == taken() != before
    assert len(json.loads(file.read_text())["parsed"]) == len(REACHED)


@pytest.mark.parametrize(
    "text", [None, "{", "{}", "[1]", '{"by": "another Python", "parsed": [["a"]]}']
)
def test_what_another_process_has_parsed_is_no_more_than_a_help(house, text):
    if text is not None:
        (house / "parsed.json").write_text(text)
    before = taken()
    forget()
    subject.recall(house / "parsed.json")
    assert not subject.RECALLED and subject.fingerprint("solve") == before


LOADED = """
import ast, json, sys
from pathlib import Path
tree = ast.parse(Path(sys.argv[1]).read_text())
for node in tree.body:
    if isinstance(node, (ast.Import, ast.ImportFrom)):
        exec(compile(ast.Module([node], []), "script", "exec"))
tops = {path.parent.name for path in Path("workflow").glob("*/__init__.py")}
print(json.dumps([name for name in sys.modules if name.split(".")[0] in tops]))
"""


FOUND = {  # by what finds it by name
    "eitskin.effects": modules(catalogue_names()),
    "eitskin.learn.models": sorted(
        {own for name in models.names() for own in models.modules(name)}
    ),
    "eitskin.data.importers": importers.modules(),
}


def with_found(script):
    """What a real script reaches, all that it may find by name with it."""
    path = ROOT / "workflow" / "scripts" / f"{script}.py"
    finds = subject.FINDS_BY_NAME & subject._closure(subject._parsed(path)[1])
    return subject.reached(script, [name for one in finds for name in FOUND[one]] or None)


@pytest.mark.parametrize("script", ["clean", "train_predictor", "diagnose", "import_recording"])
def test_all_that_python_loads_for_a_script_counts(script):
    path = ROOT / "workflow" / "scripts" / f"{script}.py"
    command = [sys.executable, "-c", LOADED, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
    loaded, reached = set(json.loads(done.stdout)), set(with_found(script))
    composite = {name for name in loaded - reached if name.startswith("eitskin.effects.")}
    left_out = {*subject.IMMATERIAL, *({subject.WORDS} if script != "diagnose" else ())}
    assert loaded - composite - left_out <= reached and composite <= {"eitskin.effects.ellipse"}
    by_name = (*importers.modules(), *FOUND["eitskin.learn.models"])  # of a file, of a row
    asked_for = subject._closure(by_name)
    inside = {name for name in reached - loaded - asked_for if not name.startswith("scripts/")}
    assert all(_imported_in_a_function(name) for name in inside), inside


def _imported_in_a_function(name):
    """Whether some function imports a module, or one that leads to it."""
    for path in (ROOT / "workflow").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                inner = {i for n in ast.walk(node) for i in _names(n)}
                if name in subject._closure(tuple(inner)):
                    return True
    return False


def _names(node):
    if isinstance(node, ast.ImportFrom) and node.module:
        return [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return [alias.name for alias in node.names] if isinstance(node, ast.Import) else []


def test_refusals_writing_and_words_are_no_code_of_a_set_or_a_model():
    modules_by_script = {script: with_found(script).keys() for script in SCRIPTS}
    assert not any(subject.IMMATERIAL & reached for reached in modules_by_script.values())
    speaking = {script for script, reached in modules_by_script.items() if subject.WORDS in reached}
    assert {"check", "diagnose", "diagnosis_report", "table_2"} <= speaking
    numeric = ("clean", "perturb", "skin_effects", "simulated_dataset", "twin", "split", "limit")
    learning = ("train_autoencoder", "train_regressor", "train_predictor", "evaluate")
    assert not speaking & {*numeric, *learning}


@pytest.mark.parametrize("name", ["mlp", "cnn", "transformer", "svr", "teachers"])
def test_a_network_is_code_of_the_models_that_are_made_of_it(name):
    using = {
        model
        for model in models.names()
        if f"eitskin.learn.networks.{name}"
        in subject.reached("train_predictor", models.modules(model))
    }
    informed = {model for model in models.names() if model.startswith(models.PHYSICS_INFORMED)}
    made = {
        "mlp": {"mlp", "autoencoder-mlp"},
        "cnn": {"cnn"},
        "transformer": {"transformer", "transformer-channels"},
        "svr": {"svr"},
        "teachers": {"autoencoder-mlp"},
    }[name]
    taught = {models.PHYSICS_INFORMED + model for model in made} & informed
    assert using == made | (informed if name == "teachers" else taught)


def test_an_effect_that_code_names_is_imported_as_what_a_configuration_names_is_told():
    for path in (ROOT / "workflow").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            named = isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant)
            if named and isinstance(node.value, ast.Name):
                assert node.value.id not in ("EFFECTS", "MODELS", "FORMATS"), path


def test_numbers_do_not_know_the_style_of_figures():
    drawing = {script for script in SCRIPTS if "eitskin.plotting" in with_found(script)}
    assert drawing == {
        "block_figures",
        "concealed_case",
        "diagnosis_report",
        *(f"figure_{k}" for k in range(1, 5)),
        "loop_figure",
    }


def test_what_code_says_is_as_python_tells_it():
    for path in (ROOT / "workflow" / "eitskin" / "data").rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        assert subject._dumped(tree) == ast.dump(tree), path


def test_the_workflow_starts_without_statistics():
    """Half a second of each start."""
    code = "import sys; from eitskin import configuration; print('scipy.stats' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout == "False\n", done.stderr
