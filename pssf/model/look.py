"""draw_look: how a site shows its films, each a little other."""

import msgspec
import numpy as np

from ..core.checks import Chance, generator_of
from ..core.keywords import keywords
from ..data.looks import Looks, Processed, looks

_CUT_SD = 2.0


@keywords()
def draw_look(*, rng: Chance) -> Processed:
    """Sample the display processing of a site: latitude, sharpness, dark and bright ends.

    Parameters
    ----------
    rng : int or numpy.random.Generator
        The only source of chance; by how much the parameters vary is in `data/looks.toml`, with its source.

    Returns
    -------
    Processed
        Parameters that `present(look=...)` takes.

    Raises
    ------
    InputError
        For an `rng` that is neither an integer nor a Generator.

    Examples
    --------
    >>> import pssf
    >>> pssf.draw_look(rng=7) == pssf.draw_look(rng=7)
    True
    """
    return drawn_look(looks(), rng=generator_of(rng))


def drawn_look(known: Looks, *, rng: np.random.Generator) -> Processed:
    """Sample display processing as `draw_look` does, by a table that is resolved."""
    spread = known.spread
    scores = np.clip(rng.standard_normal(5), -_CUT_SD, _CUT_SD)
    gains = (spread.latitude_gain, spread.edge_gain)
    if rng.random() < spread.plain:
        gains = (spread.plain_latitude_gain, spread.plain_edge_gain)
    laws = (*gains, spread.dark, spread.bright, spread.bend)
    latitude, edge, dark, bright, bend = (
        round(float(np.clip(law.mean + law.sd * score, law.low, law.high)), 4)
        for law, score in zip(laws, scores, strict=True)
    )
    return msgspec.structs.replace(
        known.processed,
        latitude_gain=latitude,
        edge_gain=round(float(np.exp(edge)), 4),
        edge_mm=spread.edge_mm,
        dark=dark,
        bright=bright,
        bend=bend,
    )
