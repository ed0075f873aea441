"""A process beside this one: it is waited for, and no way of failing that it has is an error here."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from pssf.core.processes import background_process
from pssf.core.processes.background_process import can_run_in_background, run_in_background

ROOT = Path(__file__).parents[1]


def ticking(path):
    """Python that writes to a file for as long as it runs."""
    lines = ("import time", "while True:", f"    open({str(path)!r}, 'a').write('.')", "    time.sleep(0.02)")
    return "\n".join(lines)


def has_stopped(path):
    """Whether nothing is written to a file that was written to."""
    assert path.exists()
    size = path.stat().st_size
    time.sleep(0.3)
    return path.stat().st_size == size


def wait_for(path):
    while not path.exists():
        time.sleep(0.02)


def processes(monkeypatch):
    """What has been started from now on."""
    started = []
    popen = subprocess.Popen

    def noted(*args, **kwargs):
        started.append(popen(*args, **kwargs))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", noted)
    return started


def run_beside(code, patience_s=60.0):
    return run_in_background("builtins", "exec", code, environment={}, timeout_s=patience_s)


def test_what_runs_beside_is_done_when_the_block_ends(tmp_path):
    with run_beside(f"open({str(tmp_path / 'made')!r}, 'w').close()"):
        pass
    assert (tmp_path / "made").exists()


def test_what_fails_is_no_error(monkeypatch):
    started = processes(monkeypatch)
    with run_beside("raise SystemError"):
        pass
    assert started[0].returncode not in (0, None)


def test_what_cannot_be_started_is_no_error(monkeypatch):
    monkeypatch.setattr(sys, "executable", str(ROOT / "no_python"))
    with run_beside(""):
        pass


def test_what_takes_too_long_is_killed(monkeypatch, tmp_path):
    started = processes(monkeypatch)
    with run_beside(ticking(tmp_path / "ticks"), patience_s=0.1):
        wait_for(tmp_path / "ticks")
    assert started[0].returncode not in (0, None)
    assert has_stopped(tmp_path / "ticks")


def fail_beside(path):
    with run_beside(ticking(path)):
        wait_for(path)
        raise KeyError


def test_it_is_killed_when_the_block_fails(monkeypatch, tmp_path):
    started = processes(monkeypatch)
    with pytest.raises(KeyError):
        fail_beside(tmp_path / "ticks")
    assert started[0].returncode is not None
    assert has_stopped(tmp_path / "ticks")


def test_it_ends_with_a_parent_that_is_killed(tmp_path):
    lines = (
        "import os, time",
        "from pssf.core.processes.background_process import run_in_background",
        f"path = {str(tmp_path / 'ticks')!r}",
        f"with run_in_background('builtins', 'exec', {ticking(tmp_path / 'ticks')!r}, "
        "environment={}, timeout_s=60.0):",
        "    while not os.path.exists(path):",
        "        time.sleep(0.02)",
        "    os._exit(0)",
    )
    subprocess.run([sys.executable, "-c", "\n".join(lines)], cwd=ROOT, check=True)
    time.sleep(0.3)
    assert has_stopped(tmp_path / "ticks")


def test_files_of_the_users_folder_are_not_run(monkeypatch, tmp_path):
    (tmp_path / "json.py").write_text(f"open({str(tmp_path / 'run')!r}, 'w').close()")
    monkeypatch.chdir(tmp_path)
    with run_beside("import json"):
        pass
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("where", "name", "value"),
    [
        (sys, "executable", "/usr/bin/blender"),
        (sys, "executable", None),
        (background_process, "count_cores", lambda: 1),
        (background_process, "parent_process", lambda: "a pool"),
    ],
)
def test_nothing_runs_beside_where_it_would_not_help_or_would_be_something_else(monkeypatch, where, name, value):
    monkeypatch.setattr(background_process, "count_cores", lambda: 2)
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    assert can_run_in_background()
    monkeypatch.setattr(where, name, value)
    assert not can_run_in_background()
