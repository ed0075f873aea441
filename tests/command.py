"""The command line, in a process of its own and in this one."""

import subprocess
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO

import pytest

from pssf import cli


def in_a_process(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """What a user sees of `pssf ARGUMENTS`."""
    script = [sys.executable, "-m", "pssf", *map(str, arguments)]
    return subprocess.run(script, capture_output=True, text=True, check=False)


def run(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """The same, without waiting for another process."""
    out, told = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(told):
        patch.setattr(sys, "argv", ["pssf", *map(str, arguments)])
        patch.setattr(warnings, "formatwarning", warnings.formatwarning)  # which a command sets
        with pytest.raises(SystemExit) as ended:
            cli.main()
    return subprocess.CompletedProcess(arguments, int(ended.value.code or 0), out.getvalue(), told.getvalue())
