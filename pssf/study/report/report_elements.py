"""Elements of a report page: figures, and sections with paragraphs, figures and one table."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field

import pandas as pd


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure of the report.

    Parameters
    ----------
    name : str
        Name of the figure and stem of its file name.
    png : bytes
        Content of the PNG file.
    alt : str
        Alternative text of the figure, for screen readers.
    caption : str
        Caption below the figure.
    """

    name: str
    png: bytes
    alt: str
    caption: str

    @property
    def uri(self) -> str:
        """Data URI of the PNG file."""
        return "data:image/png;base64," + b64encode(self.png).decode("ascii")


@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of the report.

    Parameters
    ----------
    name : str
        Identifier of the section in the page.
    title : str
        Heading of the section and entry in the table of contents.
    sentences : sequence of str
        Paragraphs below the heading.
    table : DataFrame
        Table of formatted cells, with column headings as printed; an empty table is not shown.
    files : sequence of str
        Names of the files in the study folder that contain the data of the table.
    undecided : str
        Reason why no conclusion can be drawn from the table; the page then collapses the table. "" if a conclusion is
        possible.
    note : str
        Note below the table.
    pictures : sequence of Picture
        Figures between the paragraphs and the table.
    """

    name: str
    title: str
    sentences: Sequence[str]
    table: pd.DataFrame = field(default_factory=pd.DataFrame)
    files: Sequence[str] = ()
    undecided: str = ""
    note: str = ""
    pictures: Sequence[Picture] = ()
