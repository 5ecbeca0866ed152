"""The tool alone, as `pip install .` has it: outside the checkout, without the workflow."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("setuptools", reason="SKIPPED: nothing here builds a wheel")
ROOT = Path(__file__).parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = PROJECT["project"]["optional-dependencies"]
IMPORTED = {"scikit-fem": "skfem", "scikit-learn": "sklearn", "pyserial": "serial"}
SAMPLE = ROOT / "docs" / "sample"
RUN = """
import sys
absent, arguments = sys.argv[1].split(","), sys.argv[2:]

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in absent:
            raise ImportError(f"{name} is not there", name=name)

sys.meta_path.insert(0, Absent())
from eitskin import cli
print(cli.__file__, file=sys.stderr)
sys.exit(cli.main(arguments))
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder with what the wheel installs."""
    source, out = (tmp_path_factory.mktemp(name) for name in ("source", "wheel"))
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copyfile(ROOT / file, source / file)
    unwanted = shutil.ignore_patterns("__pycache__", "*.egg-info", "config", "rules", "scripts")
    shutil.copytree(ROOT / "workflow", source / "workflow", ignore=unwanted)
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", out]
    command = [sys.executable, "-m", "pip", "wheel", *options, source]
    subprocess.run(command, check=True, capture_output=True, text=True)
    (wheel,) = out.glob("*.whl")
    with zipfile.ZipFile(wheel) as content:
        content.extractall(out / "site")
    return out / "site"


def run(site, folder, *arguments):
    """The tool's exit code, stdout and stderr, where nothing is that other extras install."""
    names = [pin.partition("==")[0] for extra in ("workflow", "rig") for pin in EXTRAS[extra]]
    absent = [IMPORTED.get(name, name).replace("-", "_") for name in names]
    absent += [path.name for path in (ROOT / "workflow").iterdir() if path.name != "eitskin"]
    done = subprocess.run(
        [sys.executable, "-c", RUN, ",".join(absent), *map(str, arguments)],
        env={"PYTHONPATH": str(site), "PATH": "", "OMP_NUM_THREADS": "1"},
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert Path(done.stderr.splitlines()[0]).is_relative_to(site)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.long
def test_a_wheel_holds_the_tool_alone(site):
    held = {path.name for path in site.iterdir()}
    assert {name for name in held if not name.endswith(".dist-info")} == {"eitskin"}


@pytest.mark.long
def test_the_sample_is_diagnosed_outside_the_checkout(site, tmp_path):
    recorded, query = (SAMPLE / f"{name}.parquet" for name in ("recording", "query"))
    code, out, _ = run(site, tmp_path, "check", recorded)
    assert code == 0 and "208 of 16 electrodes" in out
    code, out, err = run(site, tmp_path, "diagnose", recorded, "--query", query, "--out", "found")
    assert code == 0, err
    assert "Electrode 6 sits 2.00" in out
    written = {path.name for path in (tmp_path / "found").iterdir()}
    assert written >= {"report.html", "diagnosis.json", "effects.yaml", "predicted.parquet"}


@pytest.mark.long
def test_what_needs_the_rig_says_so_without_it(site, tmp_path):
    code, out, err = run(site, tmp_path, "rig", "--help")
    assert code in (0, 2) and "Traceback" not in err + out
