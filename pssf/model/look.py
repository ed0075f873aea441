"""draw_look: how a site shows its films, each a little other."""

import msgspec
import numpy as np

from ..core.checks import require_generator
from ..data.looks import Looks, Processed, looks

_CUT_SD = 2.0


def draw_look(*, rng: np.random.Generator) -> Processed:
    """Parameters of `present(look=...)` as they vary from site to site: latitude, sharpness, dark and bright ends.

    By how much is in `data/looks.toml`, with its source.
    raises  InputError for what is no generator
    """
    return drawn_look(looks(), rng=rng)


def drawn_look(known: Looks, *, rng: np.random.Generator) -> Processed:
    """`draw_look` by a table that is known."""
    require_generator(rng)
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
