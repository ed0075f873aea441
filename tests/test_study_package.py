"""Check optional libraries and lazy imports of `pssf.study`."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from pssf import study
from pssf.core.checks import InputError


def test_missing_study_libraries_give_an_error_with_the_pip_command(monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(study, "find_spec", lambda name: None if name == "sklearn" else find_spec(name))
    with pytest.raises(InputError, match=r"not installed: scikit-learn; .*pip install '.\[study\]'"):
        study.require_extra()


def test_importing_the_study_does_not_import_its_libraries():
    libraries = ("radiomics", "mirp", "sklearn", "xgboost", "pandas")
    check = f"import sys, pssf.study; print([m for m in {libraries} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, cwd=Path(__file__).parents[1])
    assert done.stdout.strip() == "[]", done.stderr
