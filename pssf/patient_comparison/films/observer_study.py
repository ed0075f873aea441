"""Make an observer study: patient and simulated radiographs in random order, with a separate answer key."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...study.report.report_elements import Picture
from ..comparison_page import Row, Table
from .contact_sheets import make_contact_sheet
from .film_features import Record

# Number of rows of the observer study sheet.
_ROWS = 4
# Number of radiographs in each row of the observer study sheet.
_A_ROW = 6


def select_observer_films(
    records: Mapping[str, Sequence[Record]], simulated: str, seed: int
) -> list[tuple[str, Record]]:
    """Select 12 patient and 12 simulated radiographs in random order.

    Parameters
    ----------
    records : mapping of str to sequence of dict
        Records of each source.
    simulated : str
        Name of the source of simulated radiographs.
    seed : int
        Seed for the random selection and the random order.

    Returns
    -------
    list of tuple of (str, dict)
        Source name and record of each radiograph; empty if there are fewer than 12 patient or simulated radiographs.
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
    """Make the sheet and the answer key of the observer study.

    Parameters
    ----------
    films_in_order : sequence of tuple of (str, dict)
        Source name and record of each radiograph, from :func:`select_observer_films`.
    load_image : callable
        Function of source name and record that returns the radiograph as a (rows, cols) uint8 array.

    Returns
    -------
    tuple of Picture
        Sheet of radiographs; empty if `films_in_order` is empty.
    tuple of Table
        Answer key, which the page does not display; empty if `films_in_order` is empty.
    """
    if not films_in_order:
        return (), ()
    films = [load_image(name, one) for name, one in films_in_order]
    rows = [(f"{k + 1} to {k + _A_ROW}", films[k : k + _A_ROW]) for k in range(0, len(films), _A_ROW)]
    key: list[Row] = [
        {"position": place, "source": name, "file": one["file"], "grade": one["grade"]}
        for place, (name, one) in enumerate(films_in_order, start=1)
    ]
    figure = Picture(
        name="observer_study",
        png=make_contact_sheet(rows),
        alt="24 radiographs, half of them simulated, in random order",
        caption="(e) Observer study: half of these radiographs are simulated. Answer key: observer_study_key.csv.",
    )
    return (figure,), (
        Table(name="observer_study_key", rows=key, caption="(e) Answer key of the observer study.", max_rows_shown=0),
    )
