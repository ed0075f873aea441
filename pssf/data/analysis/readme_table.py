"""Layout of the measured tables in the READMEs (``data/readme.toml``)."""

from functools import cache
from typing import Any

from msgspec import field

from ..data_files import load_data_table
from ..table_records import Record, parse_record


class TableLayout(Record, frozen=True):
    """Layout of one measured table.

    Attributes
    ----------
    command : str
        Command that measures the values. Names in braces are replaced by options of the run.
    columns : dict of str to str
        Heading -> format of its cells, as in `str.format`. ``{name!p}`` shows underscores as spaces.
    rows : str
        Name of the measurement, as in the name of its CSV file; empty for the name of the table.
    row_filters : tuple of dict
        Alternatives, each column -> values; only rows that fit one of them are shown.
    group_by : tuple of str or None
        Columns; rows that agree in all of them are merged into one. The merged row has further columns: count, and
        least_, most_ and total_ of every other numeric column. An empty tuple merges all rows; None merges none.
    value_labels : dict of str to dict of str to str
        Column -> value -> text that is shown instead.
    pivot_format : str
        Format whose values head further columns.
    headings : tuple of str
        The further columns that are shown, in order.
    cell_format : str
        Format of the cells in the further columns.
    """

    command: str
    columns: dict[str, str]
    rows: str = ""
    row_filters: tuple[dict[str, tuple[Any, ...]], ...] = ()
    group_by: tuple[str, ...] | None = None
    value_labels: dict[str, dict[str, str]] = field(default_factory=dict)
    pivot_format: str = ""
    headings: tuple[str, ...] = ()
    cell_format: str = ""


class ReadmeTables(Record, frozen=True):
    """The READMEs of a source checkout, and their measured tables and pictures.

    Attributes
    ----------
    files : tuple of str
        Paths of the READMEs, relative to the checkout.
    picture : dict of str to str
        Name of a picture that shows measured values -> its path.
    table : dict of str to TableLayout
        Name -> layout.
    """

    files: tuple[str, ...]
    picture: dict[str, str]
    table: dict[str, TableLayout]

    def tables_showing(self, measured: str) -> list[str]:
        """List the tables that show a measurement.

        Parameters
        ----------
        measured : str
            Name of the measurement.

        Returns
        -------
        list of str
            Names of the tables.
        """
        return [name for name, layout in self.table.items() if (layout.rows or name) == measured]


@cache
def load_readme_tables() -> ReadmeTables:
    """Load the layouts of all tables; a layout with ``like`` takes missing entries from the layout that it names.

    Returns
    -------
    ReadmeTables
        Content of ``data/readme.toml``.
    """
    given = load_data_table("readme")
    layouts = given["table"]
    for name, layout in layouts.items():
        if "like" in layout:
            layouts[name] = layouts[layout.pop("like")] | layout
    return parse_record(ReadmeTables, given, "readme")
