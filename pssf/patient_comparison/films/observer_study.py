"""Observer study: a sheet of patient and simulated radiographs in random order, with a separate key."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...study.report.report_page import Picture
from ..comparison_page import Row, Table
from .contact_sheets import make_contact_sheet
from .film_features import Record

# Number of rows of the sheet.
_ROWS = 4
# Number of radiographs per row.
_A_ROW = 6


def select_observer_films(
    records: Mapping[str, Sequence[Record]], simulated: str, seed: int
) -> list[tuple[str, Record]]:
    """Select 24 radiographs in random order, half of them patient radiographs.

    Parameters
    ----------
    records : mapping of str to sequence of dict
        Records of each source.
    simulated : str
        Name of the source of simulated radiographs.
    seed : int
        Seed of selection and order.

    Returns
    -------
    list of tuple of (str, dict)
        Source and record of each radiograph; empty if patient or simulated radiographs are too few.
    """
    usable = {name: [one for one in of if one["status"] == "found"] for name, of in records.items()}
    real = max((name for name in usable if name != simulated), key=lambda name: len(usable[name]), default=None)
    half = _ROWS * _A_ROW // 2
    if real is None or min(len(usable.get(simulated, ())), len(usable[real])) < half:
        return []
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(77,)))
    chosen = [(name, usable[name][k]) for name in (real, simulated) for k in rng.permutation(len(usable[name]))[:half]]
    return [chosen[k] for k in rng.permutation(len(chosen))]


def make_observer_sheet(
    films_in_order: Sequence[tuple[str, Record]], load_image: Callable[[str, Record], NDArray[np.uint8]]
) -> tuple[tuple[Picture, ...], tuple[Table, ...]]:
    """Make the sheet of the observer study and its key.

    Parameters
    ----------
    films_in_order : sequence of tuple of (str, dict)
        Source and record of each radiograph, from :func:`select_observer_films`.
    load_image : callable
        Function of source and record that returns the (rows, cols) uint8 radiograph.

    Returns
    -------
    tuple of Picture
        Sheet of radiographs; empty if there are none.
    tuple of Table
        Key, which is not displayed on the page; empty if there are no radiographs.
    """
    if not films_in_order:
        return (), ()
    films = [load_image(name, one) for name, one in films_in_order]
    rows = [(f"{k + 1} to {k + _A_ROW}", films[k : k + _A_ROW]) for k in range(0, len(films), _A_ROW)]
    key: list[Row] = [
        {"place": place, "source": name, "file": one["file"], "grade": one["grade"]}
        for place, (name, one) in enumerate(films_in_order, start=1)
    ]
    figure = Picture(
        name="blind",
        png=make_contact_sheet(rows),
        alt="24 radiographs, half of them simulated, in random order",
        caption="(e) Observer study: half of these radiographs are simulated. The key is in films_blind.csv.",
    )
    return (figure,), (Table(name="films_blind", rows=key, caption="(e) Key of the observer study.", max_rows_shown=0),)
