"""Check the installed package: built files, dependencies and plain pip in an empty environment."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Environment variables except those of Python, uv and the virtual environment of the tests.
CLEAN = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL", "UV_"))}


def run(*command: object, cwd: Path) -> str:
    """Run a command, require exit code 0 and return the standard output."""
    done = subprocess.run(list(map(str, command)), cwd=cwd, env=CLEAN, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


def find_interpreter(release: str) -> str:
    """Return the path of a Python release, or skip the test."""
    path = shutil.which(f"python{release}")
    if path is None or subprocess.run([path, "-c", ""], capture_output=True, check=False).returncode:
        pytest.skip(f"no python{release} on this machine")
    return path


@pytest.fixture(scope="session")
def built(tmp_path_factory) -> tuple[Path, Path]:
    """Build the wheel and the source distribution and return their paths."""
    uv = shutil.which("uv")
    if uv is None:
        pytest.skip("uv is not installed")
    out = tmp_path_factory.mktemp("dist")
    run(uv, "build", "--out-dir", out, ROOT, cwd=out)
    (wheel,), (source,) = out.glob("*.whl"), out.glob("*.tar.gz")
    return wheel, source


@pytest.fixture
def empty(tmp_path) -> Path:
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


def install(release: str, requirement: str, folder: Path) -> Path:
    """Install a requirement with pip in a new environment and return the folder of its commands."""
    run(find_interpreter(release), "-m", "venv", folder, cwd=folder.parent)
    run(folder / "bin" / "pip", "install", requirement, cwd=folder.parent)
    return folder / "bin"


def test_exactly_the_listed_python_releases_are_supported():
    allowed = SpecifierSet(PROJECT["requires-python"])
    assert [f"3.{minor}" for minor in range(9, 20) if f"3.{minor}.0" in allowed] == list(PYTHONS)
    named = [line.rsplit(" :: ", 1)[1] for line in PROJECT["classifiers"] if ":: Python ::" in line]
    assert named == ["3", *PYTHONS]


def test_only_the_extra_pyradiomics_requires_pyradiomics():
    extras = PROJECT["optional-dependencies"]
    assert [name for name, needs in extras.items() if any(need.startswith("pyradiomics") for need in needs)] == [
        "pyradiomics"
    ]
    assert any(need.startswith("mirp") and ";" not in need for need in extras["study"])


def test_the_version_is_the_same_in_project_citation_and_changelog():
    version = PROJECT["version"]
    assert re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1] == version
    assert f"\n## [{version}] - " in (ROOT / "CHANGELOG.md").read_text()
    assert not [path for path in (ROOT / "pssf").rglob("*.py") if re.search(rf"[\"']{version}[\"']", path.read_text())]


# Modules that only extras may import. SpekPy, a core dependency, installs matplotlib but never imports it.
MODULES_OF_EXTRAS = (
    "pandas", "matplotlib", "radiomics", "mirp", "SimpleITK", "itk", "sklearn", "skimage", "xgboost", "jinja2", "skops",
    "feature_engine", "starlette", "uvicorn", "distributed",
)  # fmt: skip
CORE = """
import json, sys
blocked = json.loads(sys.argv.pop(1))
class BlockImports:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, BlockImports())
from pssf.cli import main
main()
"""


@pytest.mark.parametrize(
    "command",
    [
        ("simulate", "--out", "one", "--formats", "tif,png,json,dcm", "--masks", "--engine", "scanline"),
        ("meshes", "--out", "solids"),
        ("cohort", "--out", "cohort", "--knees", "1,0,0", "--protocols", "small.toml"),
        ("protocols",),
        ("knees",),
    ],
    ids=lambda command: command[0],
)
def test_the_core_commands_import_no_library_of_an_extra(command, empty):
    small = 'base = "reference"\nrows = 64\ncols = 64\npixel_mm = 4.8\n'
    (empty / "small.toml").write_text(small)
    more = ("--protocol", "small.toml") if command[0] == "simulate" else ()
    run(sys.executable, "-c", CORE, json.dumps(MODULES_OF_EXTRAS), *command, *more, cwd=empty)


def test_wheel_and_source_distribution_contain_the_expected_files(built):
    wheel, source = built
    names = zipfile.ZipFile(wheel).namelist()
    assert {"pssf/py.typed", "pssf/protocols/reference.toml", "pssf/data/grades/paper.toml"} <= set(names)
    assert {name.split("/")[0] for name in names} == {"pssf", wheel.stem.split("-py3")[0] + ".dist-info"}
    with tarfile.open(source) as archive:
        inside = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    assert {"README.md", "CHANGELOG.md", "CITATION.cff", "examples/knees.png", "tests/test_installation.py"} <= inside
    assert not {".git", "uv.lock"} & {name.split("/")[0] for name in inside}


def test_the_package_description_has_no_relative_links(built):
    with zipfile.ZipFile(built[0]) as wheel:
        (name,) = (name for name in wheel.namelist() if name.endswith("METADATA"))
        text = wheel.read(name).decode()
    assert re.search(r"^# PSSF\b", text, re.MULTILINE)
    assert "![" not in text
    assert re.findall(r"\]\((?!https?:)", text) == []
    assert "[examples]" not in text


@pytest.mark.slow
@pytest.mark.parametrize("release", PYTHONS)
def test_the_study_installed_by_pip_measures_features(release, built, tmp_path, empty):
    commands = install(release, f"{built[0]}[study]", tmp_path / "environment")
    few = ("--knees", "1,0,1", "--protocols", "reference")
    output = run(commands / "pssf", "study", *few, "--until", "features", "--out", "one", cwd=empty)
    assert output.startswith("features ")
    assert "glcm_Contrast" in (empty / "one" / "features.csv").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("release", PYTHONS)
def test_the_core_installed_by_pip_simulates_a_radiograph(release, tmp_path, empty):
    commands = install(release, str(ROOT), tmp_path / "environment")
    run(commands / "pssf", "simulate", "--out", "one", "--engine", "scanline", "--set", "mas=2", cwd=empty)
    assert {path.suffix for path in (empty / "one").iterdir()} == {".tif", ".png", ".json"}
