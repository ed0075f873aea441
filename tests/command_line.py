"""Helpers that run the command line in a new process or in the process of the test."""

import subprocess
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO

import pytest

from pssf import cli


def run_in_process(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """Run `pssf ARGUMENTS` in a new process."""
    script = [sys.executable, "-m", "pssf", *map(str, arguments)]
    return subprocess.run(script, capture_output=True, text=True, check=False)


def run(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """Run `pssf ARGUMENTS` in the process of the test, which is faster than a new process."""
    out, errors = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(errors):
        patch.setattr(sys, "argv", ["pssf", *map(str, arguments)])
        patch.setattr(warnings, "formatwarning", warnings.formatwarning)  # commands replace it
        with pytest.raises(SystemExit) as ended:
            cli.main()
    return subprocess.CompletedProcess(arguments, int(ended.value.code or 0), out.getvalue(), errors.getvalue())
