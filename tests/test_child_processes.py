"""Check child processes: they run no files of the working folder and can be started by any program."""

import multiprocessing
import os
import subprocess
import sys

import pytest

import pssf
from pssf.core.processes.child_processes import build_python_command, start_without_working_folder
from pssf.core.processes.parallel_map import count_cores, map_in_parallel

TINY = 'base = "reference"\nname = "tiny"\nrows = 64\ncols = 64\npixel_mm = 4.8\nscatter = "none"\ntexture = "none"\n'
# Standard library modules that a worker imports when it starts.
SHADOWS = ("signal", "struct", "random", "selectors", "pickle", "socket", "tempfile", "logging")
MAPPED = """
from pssf.core.processes.parallel_map import map_in_parallel

if __name__ == "__main__":
    print(map_in_parallel(abs, [-1, -2, -3], shared={}, workers=2))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Make a working folder whose files have the names of standard library modules."""
    monkeypatch.chdir(tmp_path)
    for name in SHADOWS:
        (tmp_path / f"{name}.py").write_text("import os\nos.write(2, b'my own file was run')\nos._exit(9)\n")
    (tmp_path / "tiny.toml").write_text(TINY)
    return tmp_path


def run_successfully(*command, **options):
    """Run a command, require exit code 0 and return the standard output."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stderr
    assert "my own" not in done.stderr
    return done.stdout


@pytest.mark.parametrize("how", [pytest.param("module", marks=pytest.mark.slow), "installed"])
def test_cohort_workers_do_not_run_files_of_the_working_folder(folder, how):
    # Like the installed command, this call does not add the working folder to the search path (option -P).
    installed = ["-P", "-c", "from pssf.__main__ import main; main()"]
    start = [sys.executable, *(["-m", "pssf"] if how == "module" else installed)]
    made = run_successfully(
        *start, "cohort", "--knees", "1,1,1", "--protocols", "tiny.toml", "--workers", "2", "--out", how
    )
    assert "manifest" in made


def test_page_workers_do_not_run_files_of_the_working_folder(folder):
    code = """
import multiprocessing
multiprocessing.get_context("spawn")  # the script's own imports may use its folder
from pssf.explore.page_worker import Worker
if __name__ == "__main__":
    worker = Worker()
    try:
        worker.ask("no such job", 1)
    except RuntimeError as error:
        print(error)
    worker.close()
"""
    (folder / "elsewhere").mkdir()
    (folder / "elsewhere" / "script.py").write_text(code)
    assert "KeyError" in run_successfully(sys.executable, "elsewhere/script.py")


def test_a_python_command_has_exactly_the_search_path_of_this_process(folder):
    command = build_python_command("import signal, json; print(json.dumps([sys.path, sys.argv[1:]]))", "one", "two")
    assert str(list(map(str, sys.path)))[1:-1].replace("'", '"') in run_successfully(*command)


def test_a_script_from_standard_input_can_start_workers():
    assert run_successfully(sys.executable, "-", input=MAPPED) == "[1, 2, 3]\n"


def test_starting_a_process_restores_environment_and_main_module(monkeypatch):
    main = sys.modules["__main__"]
    monkeypatch.setattr(main, "__file__", "<stdin>", raising=False)
    for value in (None, "0"):
        monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
        if value is not None:
            monkeypatch.setenv("PYTHONSAFEPATH", value)
        with start_without_working_folder():
            assert os.environ["PYTHONSAFEPATH"] == "1"
            assert main.__file__ is None
        assert os.environ.get("PYTHONSAFEPATH") == value
        assert main.__file__ == "<stdin>"


def map_in_daemon(answers):
    """Put the number of cores, a result and an error message from a daemonic process into a queue."""
    try:
        map_in_parallel(abs, [-1, -2], shared={}, workers=2)
    except pssf.InputError as error:
        answers.put((count_cores(), map_in_parallel(abs, [-1, -2], shared={}, workers=count_cores()), str(error)))


def test_a_daemonic_process_allows_only_one_worker():
    context = multiprocessing.get_context("spawn")
    answers = context.Queue()
    process = context.Process(target=map_in_daemon, args=(answers,), daemon=True)
    process.start()
    count, results, message = answers.get(timeout=300)
    process.join()
    assert (count, results) == (1, [1, 2])
    assert message.startswith("workers must be 1 in a daemonic process")
    assert "\n" not in message
