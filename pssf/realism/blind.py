"""A reader's test: simulated and real films in random order on one sheet, and the key in a table beside it."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..study.report.page import Picture
from .films import Record
from .page import Row, Table
from .sheets import sheet

_ROWS, _A_ROW = 4, 6


def blind_choice(records: Mapping[str, Sequence[Record]], simulated: str, seed: int) -> list[tuple[str, Record]]:
    """24 films, half of them real, in random order: source and record; none where either source has too few.

    records    source -> one record a film
    simulated  which source is
    seed       of the choice and the order
    """
    usable = {name: [one for one in of if one["status"] == "found"] for name, of in records.items()}
    real = max((name for name in usable if name != simulated), key=lambda name: len(usable[name]), default=None)
    half = _ROWS * _A_ROW // 2
    if real is None or min(len(usable.get(simulated, ())), len(usable[real])) < half:
        return []
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(77,)))
    chosen = [(name, usable[name][k]) for name in (real, simulated) for k in rng.permutation(len(usable[name]))[:half]]
    return [chosen[k] for k in rng.permutation(len(chosen))]


def blind_test(
    order: Sequence[tuple[str, Record]], form: Callable[[str, Record], NDArray[np.uint8]]
) -> tuple[tuple[Picture, ...], tuple[Table, ...]]:
    """A sheet of films and its key; nothing where there are no films.

    order  of `blind_choice`
    form   source and record -> (rows, cols) the film as it is shown
    """
    if not order:
        return (), ()
    films = [form(name, one) for name, one in order]
    rows = [(f"{k + 1} to {k + _A_ROW}", films[k : k + _A_ROW]) for k in range(0, len(films), _A_ROW)]
    key: list[Row] = [
        {"place": place, "source": name, "file": one["file"], "grade": one["grade"]}
        for place, (name, one) in enumerate(order, start=1)
    ]
    figure = Picture(
        name="blind",
        png=sheet(rows),
        alt="24 films, half of them simulated, in random order",
        caption="(e) Half of these are simulated; which, is in films_blind.csv.",
    )
    return (figure,), (Table(name="films_blind", rows=key, caption="(e) Key of the reader's test.", shown=0),)
