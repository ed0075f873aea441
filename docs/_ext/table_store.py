"""Store the tables and pictures of the validation pages, each with a record of its measurement.

Tables are CSV files and pictures are PNG files in ``docs/validation/tables``. A JSON file of the same name contains
command, date, machine and note of the measurement, and digests of code, data and command. If the table was confirmed
later, the JSON file also contains date, evidence and digests of the confirmation.
"""

import csv
import hashlib
import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from code_digest import compute_code_digest, compute_data_digest
from table_layout import Layout, load_layouts, read_rows

from pssf.io.run_record import describe_machine

ROOT = Path(__file__).resolve().parents[2]
# Value that replaces the digest of tables that were measured before digests were recorded.
UNKNOWN = "unknown"
# Command options that do not change a result.
_IRRELEVANT = ("--out", "--workers", "--scheduler", "--readme")
# Defaults of command options: a command that gives a default value equals a command that omits the option.
_DEFAULTS = {
    "study": {"--preset": "quick", "--engine": "scanline", "--seed": "0"},
    "validate": {"--knees": "30"},
    "quality": {"--protocol": "reference"},
    "compare-patients": {"--protocol": "reference", "--knees": "200", "--grade-table": "population", "--seed": "0"},
}
# Options of `pssf compare-patients`, each of which adds tables and does not change the other tables.
_PATIENT_FOLDERS = ("--films", "--bones", "--cohort", "--compare", "--data")


@dataclass(frozen=True)
class StaleEntry:
    """Table or picture that was measured with other code, other data or another command.

    Attributes
    ----------
    name : str
        Name of the table or picture.
    page : str
        Name of the page that shows the table or picture, without suffix; empty if no page shows it.
    date : str
        Date of the measurement.
    reason : str
        Change since the measurement, such as "code changed".
    """

    name: str
    page: str
    date: str
    reason: str


@dataclass(frozen=True)
class TableStore:
    """All measured tables and pictures of a source folder.

    Parameters
    ----------
    root : Path
        Source folder that contains ``pssf`` and ``docs``.
    """

    root: Path = ROOT

    @property
    def pages(self) -> Path:
        """Return the folder of the validation pages."""
        return self.root / "docs" / "validation"

    def load_layouts(self) -> dict[str, Layout]:
        """Load the layouts of all tables and pictures; see `table_layout.load_layouts`."""
        return load_layouts(self.pages / "tables.toml")

    def file_of(self, layout: Layout) -> Path:
        """Return the stored file of a table (CSV) or picture (PNG)."""
        return self.pages / "tables" / f"{layout.name}.{'csv' if layout.kind == 'table' else 'png'}"

    def load_cells(self, layout: Layout) -> list[list[str]]:
        """Load the headings and the cells of a stored table."""
        with self.file_of(layout).open(newline="", encoding="utf-8") as file:
            return list(csv.reader(file))

    def load_record(self, name: str) -> dict[str, Any]:
        """Load the record of a stored table or picture."""
        path = self._record_file(name)
        if not path.exists():
            raise ValueError(f"table {name} is missing in {path.parent}: measure the table, then run `update`")
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return record

    def compute_digest(self, layout: Layout, checkout: Path | None = None) -> dict[str, str]:
        """Compute the digests of code, data and command on which a table depends.

        Parameters
        ----------
        layout : Layout
            Layout of the table.
        checkout : Path or None
            Source folder with which the table was measured; None for `root`.

        Returns
        -------
        dict of str to str
            SHA-256 of code, data and command.
        """
        folder = (checkout or self.root).resolve()
        return {
            "code": compute_code_digest(folder, layout.measured_by),
            "data": compute_data_digest(folder, layout.measured_by),
            "command": hashlib.sha256(layout.command.encode()).hexdigest(),
        }

    def update(
        self,
        folder: Path,
        names: tuple[str, ...] = (),
        *,
        checkout: Path | None = None,
        renamed: Mapping[str, str] | None = None,
        origin: Mapping[str, str],
    ) -> tuple[list[str], list[str]]:
        """Store all tables and pictures that a run measured.

        Parameters
        ----------
        folder : Path
            Output folder of the run.
        names : tuple of str
            Tables and pictures to update; empty for all tables and pictures that the run measured.
        checkout : Path or None
            Source folder with which the run was made; None for `root`.
        renamed : mapping of str to str, optional
            Current name of each renamed column, keyed by its earlier name.
        origin : mapping of str to str
            Command, date, machine or note that replace the values in run.json.

        Returns
        -------
        updated : list of str
            Names of the tables and pictures that were stored.
        skipped : list of str
            One line for each table in the folder for which the layout specifies another command.

        Raises
        ------
        ValueError
            If a column is missing, or if neither run.json nor `origin` gives the command.
        """
        if not folder.is_dir():
            raise ValueError(f"run must be a folder, got {folder}")
        path = folder / "run.json"
        run = {"note": "", **(json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}), **origin}
        if "command" not in run:
            raise ValueError(f"folder {folder} contains no run.json: specify its command with --command")
        updated, skipped = [], []
        for name, layout in self.load_layouts().items():
            source = folder / layout.file.partition("#")[0]
            if (names and name not in names) or not source.exists():
                continue
            if not is_command_of(layout.command, run["command"]):
                skipped.append(f"{name} is not updated, because it is measured by `{layout.command}`")
                continue
            self._store(layout, folder, renamed or {})
            facts = {"command": layout.command, **{key: run[key] for key in ("date", "machine", "note") if key in run}}
            facts.setdefault("date", _date_of(source))
            facts.setdefault("machine", describe_machine())
            self._save_record(name, {**facts, "digest": self.compute_digest(layout, checkout)})
            updated.append(name)
        return updated, skipped

    def confirm(self, name: str, evidence: str, day: str) -> None:
        """Record that a table is unchanged with the current code and data.

        Parameters
        ----------
        name : str
            Name of the table or picture.
        evidence : str
            Evidence that the table is unchanged.
        day : str
            Date of the confirmation, such as 2026-11-28.

        Raises
        ------
        ValueError
            If the table was never measured, or was measured by another command.
        """
        layout, record = self.load_layouts()[name], self.load_record(name)
        if record["command"] != layout.command:
            raise ValueError(
                f"command of {name} must be `{layout.command}` to be confirmed, got `{record['command']}`: measure it"
            )
        confirmed = {"date": day, "by": evidence, "digest": self.compute_digest(layout)}
        self._save_record(name, record | {"confirmed": confirmed})

    def explain_staleness(self, layout: Layout) -> str:
        """Describe what has changed since a table was measured or confirmed.

        Parameters
        ----------
        layout : Layout
            Layout of the table.

        Returns
        -------
        str
            Description such as "code and data changed"; empty if nothing has changed.
        """
        record = self.load_record(layout.name)
        digests = [record.get("confirmed", {}).get("digest"), record["digest"]]
        known = [digest for digest in digests if isinstance(digest, dict)]
        if record["command"] != layout.command:
            return "command changed"
        if not known:
            return "code and data not recorded"
        now = self.compute_digest(layout)
        changes = [" and ".join(part for part in now if now[part] != digest.get(part)) for digest in known]
        return "" if "" in changes else f"{changes[0]} changed"

    def list_stale(self) -> list[StaleEntry]:
        """List all tables and pictures that are stale.

        Returns
        -------
        list of StaleEntry
            Entries in the order of the pages.
        """
        pages, stale = self.find_pages(), []
        for name, layout in self.load_layouts().items():
            reason = self.explain_staleness(layout)
            if reason:
                stale.append(StaleEntry(name, pages.get(name, ""), self.load_record(name)["date"], reason))
        order = list(dict.fromkeys(pages.values()))
        return sorted(stale, key=lambda entry: order.index(entry.page) if entry.page in order else len(order))

    def find_pages(self) -> dict[str, str]:
        """Return the page of each table or picture, without suffix, keyed by the name of the table or picture."""
        return {
            line.split()[-1]: path.stem
            for path in sorted(self.pages.glob("*.md"))
            for line in path.read_text(encoding="utf-8").splitlines()
            if line.startswith("```{measured-")
        }

    def _store(self, layout: Layout, folder: Path, renamed: Mapping[str, str]) -> None:
        """Store the cells of a table, or a picture, from the output folder of a run."""
        if layout.kind == "picture":
            self.file_of(layout).write_bytes((folder / layout.file).read_bytes())
            return
        rows = read_rows(layout, folder, renamed)
        lines = [layout.list_headings(), *layout.format_cells(rows)]
        with self.file_of(layout).open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(lines)

    def _save_record(self, name: str, record: Mapping[str, Any]) -> None:
        """Save the record of a table or picture."""
        text = json.dumps(record, indent=1, ensure_ascii=False) + "\n"
        self._record_file(name).write_text(text, encoding="utf-8")

    def _record_file(self, name: str) -> Path:
        """Return the path of the record of a table or picture."""
        return self.pages / "tables" / f"{name}.json"


def is_command_of(wanted: str, command: str) -> bool:
    """Return whether two commands measure the same tables; output folder and number of workers are ignored.

    Parameters
    ----------
    wanted : str
        Command of a layout.
    command : str
        Command of a run.

    Returns
    -------
    bool
        True if the two commands measure the same tables.
    """
    name, options = _parse_command(wanted)
    run_name, run_options = _parse_command(command)
    if name == "validate":
        # The tables of a run are independent of each other. Tables whose command omits --knees do not depend on this
        # option.
        tables = run_options.get("--tables", options["--tables"]).split(",")
        run_options["--tables"] = options["--tables"] if options["--tables"] in tables else ""
        if "--knees" not in shlex.split(wanted):
            run_options["--knees"] = options["--knees"]
    for folder in _PATIENT_FOLDERS:
        if folder not in options:
            run_options.pop(folder, None)
    return (name, options) == (run_name, run_options)


def _parse_command(command: str) -> tuple[str, dict[str, str]]:
    """Parse a pssf or python command line into the command and its options, with default values."""
    words = shlex.split(command)
    if "pssf" in words:
        words = words[words.index("pssf") + 1 :]
    elif "python" in words:
        words = words[words.index("python") :]
    if not words:
        return "", {}
    options = dict(_DEFAULTS.get(words[0], {}))
    rest = iter(words[1:])
    for word in rest:
        if not word.startswith("-"):
            continue  # A positional argument is the output folder of a script.
        option, equals, value = word.partition("=")
        options[option] = value if equals else next(rest, "")
    for option in _IRRELEVANT:
        options.pop(option, None)
    for option in _PATIENT_FOLDERS:
        if option in options:
            # The name of a cohort folder identifies the cohort. Names of patient folders differ between machines.
            options[option] = Path(options[option]).name if option == "--cohort" else "FOLDER"
    return words[0], options


def _date_of(path: Path) -> str:
    """Return the modification date of a file, such as 2026-11-28."""
    return date.fromtimestamp(path.stat().st_mtime).isoformat()
