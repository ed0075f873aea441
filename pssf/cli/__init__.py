"""The command line: pssf simulate | meshes | cohort | benchmark | study | read | features | accuracy | quality |
realism | grades | protocols | knees | explore.

options    what commands share
make       simulate, meshes, cohort
benchmark  benchmark
study      study
read       read
features   features
measure    accuracy, quality, realism, grades, protocols, knees
look       explore

Commands import what they need when they run, so that help does not wait for what computes.
"""

import errno
import re
import sys
import warnings
from importlib.metadata import version
from typing import Annotated, Any

import typer

from . import make, measure
from .benchmark import benchmark
from .features import features
from .look import explore
from .read import read
from .study import study

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_PYTHONS = warnings.formatwarning
# Earlier name of an option -> its name.
_EARLIER = {"--grades": "--grade-table", "--table": "--grade-table"}
_COMMANDS = (
    *(make.simulate, make.meshes, benchmark, study, read, features),
    *(measure.accuracy, measure.quality, measure.realism, measure.grades, measure.protocols, measure.knees),
    explore,
)


def _tell_version(asked: bool) -> None:
    if asked:
        print(f"pssf {version('pssf')}")
        raise typer.Exit


@app.callback()
def options(
    asked: Annotated[bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="Tell it.")] = False,
) -> None:
    """Knee radiographs from physics, with labels that are true by construction, and the study they exist for."""


for command in _COMMANDS:
    app.command()(command)
app.add_typer(make.cohort_app, name="cohort")


def main() -> None:
    """Run the command line; bad input ends in one line and exit code 2."""
    warnings.formatwarning = _as_a_line
    try:
        sys.argv[1:] = _named_now(sys.argv[1:])
        _require_once(sys.argv[1:])
        sys.exit(app(standalone_mode=False))
    except (typer.Abort, KeyboardInterrupt) as error:
        # The parser makes an Abort of an interrupt, and of the end of any file too early, which is no interrupt.
        if isinstance(error.__cause__, EOFError):
            raise error.__cause__ from None
        print("pssf: stopped; run the same command to go on from there", file=sys.stderr)
        sys.exit(130)
    except Exception as error:
        sys.exit(_refused(error))


def _named_now(arguments: list[str]) -> list[str]:
    """The arguments with options by earlier names under their names of now, and a line that says so."""
    named = []
    for word in arguments:
        name, equals, value = word.partition("=")
        now = _EARLIER.get(name, name)
        if now != name:
            print(f"pssf: {name} is now {now}; the earlier name will be removed", file=sys.stderr)
        named.append(now + equals + value)
    return named


def _as_a_line(message: Warning | str, category: type[Warning], filename: str, lineno: int, line: Any = None) -> str:
    """A warning of the package's own as a refusal is told; of others as Python does."""
    if category.__module__.split(".")[0] == "pssf":
        return f"pssf: {message}\n"
    return _PYTHONS(message, category, filename, lineno, line)


def _require_once(arguments: list[str]) -> None:
    """Refuse an option that is given twice where the parser would keep the last one and say nothing."""
    given = [word.split("=")[0] for word in arguments if word.startswith("--")]
    twice = sorted({name for name in given if given.count(name) > 1} - {"--"})
    if not twice:
        return
    from ..core.checks import InputError

    root = typer.main.get_command(app)
    commands = [root]
    for command in commands:
        commands += getattr(command, "commands", {}).values()
    lists = {name for command in commands for option in command.params if _is_list(option) for name in option.opts}
    for name in twice:
        if name not in lists:
            raise InputError(f"{name}: given {given.count(name)} times; allowed: once")


def _is_list(option: Any) -> bool:
    return getattr(option, "multiple", False) or option.nargs != 1


def _refused(error: Exception) -> int:
    """Tell of a refusal in one line; returns the exit code. What is no refusal is raised again."""
    from ..core.checks import InputError, one_line
    from ..core.workers import WorkersLostError

    if isinstance(error, WorkersLostError):
        print(f"pssf: {error}; run the same command to go on from there", file=sys.stderr)
        return 1
    if isinstance(error, MemoryError):
        reason = one_line(str(error)) or "of this process"
        print(f"pssf: memory = too little ({reason}); allowed: fewer rows and cols, or fewer workers", file=sys.stderr)
        return 1
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        print(f"pssf: {one_line(f'file {error.filename}: {error.strerror}')}; allowed: a shorter path", file=sys.stderr)
        return 2
    # A misused option: the parser's own classes are private, their one-line message is not.
    by_parser = getattr(error, "format_message", None)
    if by_parser is None and not isinstance(error, InputError):
        raise error
    message: str = by_parser() if by_parser else str(error)
    if by_parser and message.startswith("Usage:"):  # no command was given: this is the help
        print(message, file=sys.stderr)
        return 2
    message = one_line(message)
    print(f"pssf: {message}{_field_hint(message)}", file=sys.stderr)
    return 2


def _field_hint(message: str) -> str:
    """How a field is given, where it was taken for an option."""
    asked = re.match(r"No such option: --([\w-]+)", message)
    if asked is None:
        return ""
    from ..model.listing import field_rows

    name = asked[1].replace("-", "_")
    kinds = [kind for kind in ("protocol", "knee") if name in [row["field"] for row in field_rows(kind)]]
    return f". A field of a {kinds[0]} is changed by --set {name}=VALUE, where a command takes it" if kinds else ""
