"""Mutation test: insert faults into a copy of the package, and report whether the tests detect each fault.

Run ``python -m tools.mutants --out results.csv`` in the folder `tests`. The faults are in `mutants.toml`.
"""

import csv
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

_CHECKOUT = Path(__file__).resolve().parents[2]
# Files that tests do not need: hidden folders, compiled modules, results of runs, the built documentation.
_NOT_COPIED = shutil.ignore_patterns(".*", "__pycache__", "runs", "_build")
# Line in the pytest summary that names a failed test.
_FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", re.MULTILINE)
_COLUMNS = ("name", "file", "found", "first_failing_test", "cpu_seconds")


class Mutant(NamedTuple):
    """One fault: `new` replaces the code `old` in a file of pssf, and one of the tests should detect the fault."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


def _load_mutants(checkout: Path) -> list[Mutant]:
    """Load all mutants, with the names that their test files have in a checkout."""
    table = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())

    def locate(test: str) -> str:
        former = table["tests_before"].get(test, test)
        return f"tests/{test if (checkout / 'tests' / f'{test}.py').is_file() else former}.py"

    return [Mutant(**one | {"tests": tuple(map(locate, one["tests"]))}) for one in table["mutant"]]


def _find_misfits(mutants: Sequence[Mutant], checkout: Path) -> list[str]:
    """Find mutants whose code does not occur exactly once in a checkout, or whose test files are missing."""
    misfits = []
    for one in mutants:
        count = (checkout / "pssf" / one.file).read_text().count(one.old)
        if count != 1:
            misfits.append(f"{one.name}: code must occur once in pssf/{one.file}, got {count} times: {one.old}")
        misfits += [f"{one.name}: no file {test}" for test in one.tests if not (checkout / test).is_file()]
    return misfits


class BrokenCopy:
    """Copy of a checkout in which the tests run, with its own caches of compiled kernels and arrays.

    Kernels are compiled anew if their own file changed. Kernels of other files that call a changed function are not,
    so a mutant must not change a kernel that is called from a kernel of another file.

    Parameters
    ----------
    checkout : Path
        Folder with the package and its tests; it stays unchanged.
    folder : Path
        Empty folder for the copy and the caches.
    limit_s : float
        Time limit of one call of pytest, in seconds.
    """

    def __init__(self, checkout: Path, folder: Path, limit_s: float) -> None:
        self.root, self.limit_s = folder / "copy", limit_s
        caches = {"NUMBA_CACHE_DIR": str(folder / "kernels"), "PSSF_CACHE_DIR": str(folder / "arrays")}
        self.environment = os.environ | caches | {"PYTHONPATH": str(self.root)}
        shutil.copytree(checkout, self.root, ignore=_NOT_COPIED)
        command = [sys.executable, "-c", "import pssf; print(pssf.__file__)"]
        used = subprocess.check_output(command, cwd=folder, env=self.environment, text=True).strip()
        if used != str(self.root / "pssf" / "__init__.py"):
            raise SystemExit(f"pssf must be imported from {self.root}, got {used}")

    def run_tests(self, *arguments: str) -> str:
        """Run tests until one fails; return the name of the failed test, "" if all pass, or why the run ended."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", *arguments]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        with subprocess.Popen(command, cwd=self.root, env=self.environment, start_new_session=True, **pipes) as run:
            try:
                output, _ = run.communicate(timeout=self.limit_s)
            except subprocess.TimeoutExpired:
                return "time limit"
            finally:
                if run.poll() is None:
                    os.killpg(run.pid, signal.SIGKILL)
        # pytest reports a usage error (4) or that no tests were collected (5).
        if run.returncode in (4, 5):
            raise SystemExit(output)
        failed = _FAILED.search(output)
        return "" if run.returncode == 0 else failed[1] if failed else f"exit code {run.returncode}"

    def try_mutant(self, mutant: Mutant) -> dict[str, object]:
        """Run the tests of one mutant and return a result row; tests that also fail without the fault do not count."""
        path, cpu_s, skipped = self.root / "pssf" / mutant.file, 0.0, list[str]()
        text, times = path.read_text(), path.stat()
        while True:
            path.write_text(text.replace(mutant.old, mutant.new))
            before_s = sum(os.times()[2:4])  # CPU time of finished child processes.
            failing = self.run_tests(*mutant.tests, *skipped)
            cpu_s += sum(os.times()[2:4]) - before_s
            # The original file time lets Python and numba reuse code compiled before the fault.
            path.write_text(text)
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
            if "::" not in failing or not self.run_tests(failing):
                break
            skipped.append(f"--deselect={failing}")
        found = "unknown" if failing == "time limit" else "yes" if failing else "no"
        return dict(zip(_COLUMNS, (mutant.name, mutant.file, found, failing, round(cpu_s, 1)), strict=True))


def main(
    only: Annotated[str, typer.Option(help="Names of mutants, separated by commas; default: all.")] = "",
    out: Annotated[Path, typer.Option(help="CSV file to write.")] = Path("results.csv"),
    checkout: Annotated[Path, typer.Option(help="Folder whose package is broken, in a copy.")] = _CHECKOUT,
    limit_s: Annotated[float, typer.Option(help="Time limit of one call of pytest, in seconds.")] = 600.0,
    check: Annotated[bool, typer.Option("--check", help="Only check that every mutant fits the checkout.")] = False,
) -> None:
    """Insert one fault at a time into a copy of the package, and write which faults the tests detect."""
    mutants = _load_mutants(checkout)
    names = only.split(",") if only else [one.name for one in mutants]
    problems = [f"no mutant {name!r}" for name in names if name not in {one.name for one in mutants}]
    if problems := problems + _find_misfits(mutants, checkout):
        raise SystemExit("\n".join(problems))
    print(f"{len(mutants)} mutants fit {checkout}")
    if check:
        return
    with tempfile.TemporaryDirectory() as folder, open(out, "w", buffering=1, newline="") as file:
        copy, table = BrokenCopy(checkout.resolve(), Path(folder).resolve(), limit_s), csv.DictWriter(file, _COLUMNS)
        table.writeheader()
        for row in (copy.try_mutant(one) for one in mutants if one.name in names):
            print(*row.values(), sep=", ", flush=True)
            table.writerow(row)


if __name__ == "__main__":
    typer.run(main)
