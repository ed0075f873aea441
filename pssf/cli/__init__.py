"""Command line of pssf.

making_commands     simulate, meshes, cohort
dataset_command     dataset
trial_command       trial, jsw-error
benchmark_command   benchmark
study_command       study
predict_command     predict
reader_command      landmarks, train-reader
film_arguments      radiographs that the user names
features_command    features
calibrate_command   calibrate
measuring_commands  validate, quality, compare-patients, separability, protocols, knees
explore_command     explore
shared_options      options common to several commands

Commands import other modules only when they run, so that the help text appears without delay.
"""

import errno
import re
import sys
import warnings
from importlib.metadata import version
from typing import Annotated, Any

import typer

from . import making_commands, measuring_commands
from .benchmark_command import benchmark
from .calibrate_command import calibrate
from .dataset_command import dataset_app
from .explore_command import explore
from .features_command import features
from .predict_command import predict
from .reader_command import landmarks, train_reader
from .study_command import study
from .trial_command import jsw_error, trial

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_PYTHON_FORMATWARNING = warnings.formatwarning
# Current names of options, keyed by deprecated name.
_RENAMED_OPTIONS = {
    "--curves": "--curve-knees",
    "--exposure": "--acquisition",
    "--exposures": "--acquisition",
    "--grades": "--grade-table",
    "--look": "--processing",
    "--pairs": "--sensitivity-knees",
    "--people": "--subjects",
    "--shares": "--sobol-samples",
    "--table": "--grade-table",
}
# Current values of options, keyed by option and deprecated value.
_RENAMED_VALUES = {("--acquisition", "drawn"): "sampled", ("--processing", "linear"): "log"}
# Current names of commands, keyed by deprecated name.
_RENAMED_COMMANDS = {
    "accuracy": "validate",
    "grades": "separability",
    "read": "predict",
    "realism": "compare-patients",
}
# Commands that are newer than the deprecated names, and use some of these names for options of their own.
_COMMANDS_WITHOUT_RENAMES = ("dataset", "trial", "jsw-error")
_COMMANDS = (
    *(
        making_commands.simulate,
        making_commands.meshes,
        benchmark,
        study,
        trial,
        jsw_error,
        predict,
        features,
        landmarks,
        train_reader,
    ),
    *(
        measuring_commands.validate,
        measuring_commands.quality,
        measuring_commands.compare_patients,
        measuring_commands.separability,
        measuring_commands.protocols,
        measuring_commands.knees,
    ),
    calibrate,
    explore,
)


def _show_version(asked: bool) -> None:
    """Print the version and exit if the user passes --version."""
    if asked:
        print(f"pssf {version('pssf')}")
        raise typer.Exit


@app.callback()
def handle_global_options(
    asked: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Simulate knee radiographs from physics, with exact labels, and run the radiomics study on them."""


for command in _COMMANDS:
    app.command()(command)
app.add_typer(making_commands.cohort_app, name="cohort")
app.add_typer(dataset_app, name="dataset")


def main() -> None:
    """Run the command line.

    Invalid input ends the run with one line on standard error and exit code 2.
    """
    warnings.formatwarning = _format_warning
    try:
        sys.argv[1:] = _replace_renamed_options(sys.argv[1:])
        _require_options_once(sys.argv[1:])
        sys.exit(app(standalone_mode=False))
    except (typer.Abort, KeyboardInterrupt) as error:
        # The parser raises Abort for an interrupt and for an unexpected end of a file. Only the end of a file is an
        # error.
        if isinstance(error.__cause__, EOFError):
            raise error.__cause__ from None
        print("pssf: stopped; run the same command again to continue", file=sys.stderr)
        sys.exit(130)
    except Exception as error:
        sys.exit(_report_error(error))


def _replace_renamed_options(arguments: list[str]) -> list[str]:
    """Replace deprecated names of commands, options and values with current names, with a notice on standard error."""
    if arguments[:1] and arguments[0] in _COMMANDS_WITHOUT_RENAMES:
        return arguments
    named: list[str] = []
    for index, word in enumerate(arguments):
        name, equals, value = word.partition("=")
        if index == 0:
            now = _RENAMED_COMMANDS.get(name, name)
        elif named[-1].startswith("--") and not name.startswith("--"):
            now = _RENAMED_VALUES.get((named[-1], name), name)
        else:
            now = _RENAMED_OPTIONS.get(name, name)
            value = _RENAMED_VALUES.get((now, value), value)
        if now != name:
            print(f"pssf: {name} was renamed to {now}, and the former name will be removed", file=sys.stderr)
        named.append(now + equals + value)
    return named


def _format_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: Any = None
) -> str:
    """Format a warning of this package as one line, and any other warning in the default format of Python."""
    if category.__module__.split(".")[0] == "pssf":
        return f"pssf: {message}\n"
    return _PYTHON_FORMATWARNING(message, category, filename, lineno, line)


def _require_options_once(arguments: list[str]) -> None:
    """Raise an error if an option is repeated, because the parser would silently use the last value."""
    given = [word.split("=")[0] for word in arguments if word.startswith("--")]
    twice = sorted({name for name in given if given.count(name) > 1} - {"--"})
    if not twice:
        return
    from ..core.checks import InputError

    root = typer.main.get_command(app)
    commands = [root]
    for command in commands:
        commands += getattr(command, "commands", {}).values()
    lists = {
        name for command in commands for option in command.params if _is_repeatable(option) for name in option.opts
    }
    for name in twice:
        if name not in lists:
            raise InputError(f"{name} must be used only once, got it {given.count(name)} times")


def _is_repeatable(option: Any) -> bool:
    """Test whether an option accepts several values."""
    return getattr(option, "multiple", False) or option.nargs != 1


def _report_error(error: Exception) -> int:
    """Print a user error in one line and return the exit code. Any other error is raised again."""
    from ..core.checks import InputError, format_one_line
    from ..core.processes.worker_processes import WorkersLostError

    if isinstance(error, WorkersLostError):
        print(f"pssf: {error}; run the same command again to continue", file=sys.stderr)
        return 1
    if isinstance(error, MemoryError):
        reason = format_one_line(str(error)) or "in this process"
        print(
            f"pssf: not enough memory ({reason}): use fewer rows and cols, or fewer workers",
            file=sys.stderr,
        )
        return 1
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        print(
            f"pssf: {format_one_line(f'file {error.filename}: {error.strerror}')}: use a shorter path",
            file=sys.stderr,
        )
        return 2
    # The error classes of the parser are private, but their method `format_message` is public.
    by_parser = getattr(error, "format_message", None)
    if by_parser is None and not isinstance(error, InputError):
        raise error
    message: str = by_parser() if by_parser else str(error)
    if by_parser and message.startswith("Usage:"):  # If no command is given, the error message is the help text.
        print(message, file=sys.stderr)
        return 2
    message = format_one_line(message)
    print(f"pssf: {message}{_format_field_hint(message)}", file=sys.stderr)
    return 2


def _format_field_hint(message: str) -> str:
    """Return a hint about --set if an unknown option is the name of a field, else an empty string."""
    asked = re.match(r"No such option: --([\w-]+)", message)
    if asked is None:
        return ""
    from ..model.field_listing import list_fields

    name = asked[1].replace("-", "_")
    kinds = [kind for kind in ("protocol", "knee") if name in [row["field"] for row in list_fields(kind)]]
    return f". To change a field of a {kinds[0]}, use --set {name}=VALUE" if kinds else ""
