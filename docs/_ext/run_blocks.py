"""Run the Python blocks of a page of the documentation, in order and in one namespace."""

import os
import re
import tempfile
from pathlib import Path
from typing import Any

# A Python block opens with ```python. Blocks of other languages are not run.
_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# A command is a line of a console block or an indented line of a README, up to a comment or a redirection.
_COMMAND = re.compile(r"^(?:\$ | {4})(\S.*?)(?:\s+#.*|\s+>.*)?$", re.MULTILINE)
_CODE = re.compile(r"^```(?!console).*?^```$", re.MULTILINE | re.DOTALL)


def read_blocks(page: Path) -> list[tuple[int, str]]:
    """Read the Python blocks of a page.

    Parameters
    ----------
    page : Path
        Markdown file.

    Returns
    -------
    list of (int, str) tuple
        Number of the first line of each block in the file, counted from 1, and code of the block.
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
        Working folder, to which the code writes its files. None for a temporary folder that is deleted afterwards.

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
                # Leading empty lines give the code the line numbers of the page in a traceback.
                exec(compile("\n" * (line - 1) + code, str(page), "exec"), names)
        finally:
            os.chdir(before)
    return names


def read_commands(page: Path) -> list[str]:
    """Read the shell commands of a page: lines of console blocks, and indented lines of a README.

    Parameters
    ----------
    page : Path
        Markdown file.

    Returns
    -------
    list of str
        Commands without prompt, comment and redirection; commands joined by ``&&`` are separate entries.
    """
    text = _CODE.sub("", page.read_text(encoding="utf-8")).replace("\\\n", " ")
    return [one.strip() for line in _COMMAND.findall(text) for one in line.split("&&")]


def check_commands(page: Path) -> list[str]:
    """Parse every ``pssf ...`` command of a page, without running it.

    Parameters
    ----------
    page : Path
        Markdown file.

    Returns
    -------
    list of str
        One line per command that the parser rejects: the command and the reason.
    """
    import shlex

    import typer

    from pssf.cli import app

    faults = []
    for line in read_commands(page):
        words = shlex.split(line)
        if "pssf" not in words or words[0] not in ("pssf", "uv"):
            continue
        command, words = typer.main.get_command(app), words[words.index("pssf") + 1 :]
        try:
            while words and words[0] in getattr(command, "commands", {}):
                command = command.commands[words[0]]  # type: ignore[attr-defined]
                words = words[1:]
            if words and getattr(command, "commands", None) and not words[0].startswith("-"):
                raise ValueError(f"no command {words[0]}")
            command.make_context("pssf", words)
        except Exception as error:
            by_parser = getattr(error, "format_message", None)
            faults.append(f"{line}: {by_parser() if by_parser else error}")
    return faults


if __name__ == "__main__":
    import sys
    import time

    for name in sys.argv[1:]:
        start = time.process_time()
        run_blocks(Path(name).resolve())
        print(f"{name}: {time.process_time() - start:.1f} s CPU", *check_commands(Path(name)), sep="\n  ", flush=True)
