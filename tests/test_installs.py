"""The package as it is installed: by plain pip, in an empty environment, run from an empty folder."""

import os
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# Nothing of the environment that the tests run in, and no configuration of uv.
CLEAN = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL", "UV_"))}


def run(*command: object, cwd: Path) -> str:
    done = subprocess.run(list(map(str, command)), cwd=cwd, env=CLEAN, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


def interpreter(release: str) -> str:
    path = shutil.which(f"python{release}")
    if path is None or subprocess.run([path, "-c", ""], capture_output=True, check=False).returncode:
        pytest.skip(f"no python{release} on this machine")
    return path


@pytest.fixture
def empty(tmp_path) -> Path:
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


def installed(release: str, what: str, folder: Path) -> Path:
    """The commands of a new environment that plain pip has put something into."""
    run(interpreter(release), "-m", "venv", folder, cwd=folder.parent)
    run(folder / "bin" / "pip", "install", what, cwd=folder.parent)
    return folder / "bin"


def test_every_python_that_is_promised_is_allowed_and_no_other():
    allowed = SpecifierSet(PROJECT["requires-python"])
    assert [f"3.{minor}" for minor in range(9, 20) if f"3.{minor}.0" in allowed] == list(PYTHONS)
    named = [line.rsplit(" :: ", 1)[1] for line in PROJECT["classifiers"] if ":: Python ::" in line]
    assert named == ["3", *PYTHONS]


@pytest.mark.slow
@pytest.mark.parametrize("release", PYTHONS)
def test_plain_pip_installs_the_core_and_it_makes_a_radiograph(release, tmp_path, empty):
    commands = installed(release, str(ROOT), tmp_path / "environment")
    run(commands / "pssf", "simulate", "--out", "one", "--engine", "scanline", "--set", "mas=2", cwd=empty)
    assert {path.suffix for path in (empty / "one").iterdir()} == {".tif", ".png", ".json"}
