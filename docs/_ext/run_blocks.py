"""Run the Python blocks of a page of the documentation, in order and in one namespace."""

import os
import re
import tempfile
from pathlib import Path
from typing import Any

# A block that opens with ```python. Blocks of other languages are not run.
_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_CONSOLE = re.compile(r"^```console\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def read_blocks(page: Path) -> list[tuple[int, str]]:
    """Read the Python blocks of a page.

    Parameters
    ----------
    page : Path
        Markdown file.

    Returns
    -------
    list of (int, str) tuple
        Number of the first line of code in the file, counted from 1, and the code.
    """
    text = page.read_text(encoding="utf-8")
    return [(text.count("\n", 0, found.start(1)) + 1, found.group(1)) for found in _BLOCK.finditer(text)]


def run_blocks(page: Path, folder: Path | None = None) -> dict[str, Any]:
    """Run every Python block of a page in one namespace.

    An error names the page and the line, because the code is compiled under the path of the page.

    Parameters
    ----------
    page : Path
        Markdown file.
    folder : Path, optional
        Working folder of the code; files are written there. None: a temporary folder, which is deleted.

    Returns
    -------
    dict of str to object
        Namespace after the last block.
    """
    blocks = read_blocks(page)
    names: dict[str, Any] = {"__name__": "__main__"}
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as spare:
        os.chdir(folder or spare)
        try:
            for line, code in blocks:
                # Empty lines in front keep the line numbers of the page in a traceback.
                exec(compile("\n" * (line - 1) + code, str(page), "exec"), names)
        finally:
            os.chdir(before)
    return names


def check_commands(page: Path) -> list[str]:
    """Parse every ``$ pssf ...`` line of the console blocks of a page, without running it.

    Parameters
    ----------
    page : Path
        Markdown file.

    Returns
    -------
    list of str
        One line per command that the command line rejects: the command and the reason.
    """
    import shlex

    import typer

    from pssf.cli import app

    faults = []
    blocks = "".join(_CONSOLE.findall(page.read_text(encoding="utf-8")))
    for line in re.findall(r"^\$ (?:uv run )?pssf (.*)$", blocks, re.MULTILINE):
        command, words = typer.main.get_command(app), shlex.split(line.split(" > ")[0], comments=True)
        try:
            while words and words[0] in getattr(command, "commands", {}):
                command = command.commands[words[0]]  # type: ignore[attr-defined]
                words = words[1:]
            command.make_context("pssf", words)
        except Exception as error:
            by_parser = getattr(error, "format_message", None)
            faults.append(f"pssf {line}: {by_parser() if by_parser else error}")
    return faults


if __name__ == "__main__":
    import sys
    import time

    for name in sys.argv[1:]:
        start = time.process_time()
        run_blocks(Path(name).resolve())
        print(f"{name}: {time.process_time() - start:.1f} s CPU", *check_commands(Path(name)), sep="\n  ", flush=True)
