"""Sample display processing, whose latitude, sharpness and grey scale vary between radiology departments."""

import msgspec
import numpy as np

from ...core.checks import RNGLike, resolve_generator
from ...core.keyword_arguments import check_keywords
from ...data.imaging.display_table import DisplayProcessing, FlatPanelProcessing, load_display_processing

# Limit to which standard scores are clipped, in standard deviations.
_TRUNCATION_SD = 2.0


@check_keywords()
def sample_display_processing(*, rng: RNGLike) -> FlatPanelProcessing:
    """Sample the display processing of a radiology department: latitude, sharpness and grey scale.

    Parameters
    ----------
    rng : int or numpy.random.Generator
        Seed or generator; the only source of randomness.

    Returns
    -------
    FlatPanelProcessing
        Parameters for ``render_for_display(processing=...)``.

    Raises
    ------
    InputError
        If `rng` is neither an integer nor a Generator.

    Notes
    -----
    ``data/looks.toml`` contains the distributions and their sources.

    Examples
    --------
    >>> import pssf
    >>> processing = pssf.sample_display_processing(rng=7)
    >>> processing == pssf.sample_display_processing(rng=7)
    True
    """
    return sample_processing_from_table(load_display_processing(), rng=resolve_generator(rng))


def sample_processing_from_table(table: DisplayProcessing, *, rng: np.random.Generator) -> FlatPanelProcessing:
    """Sample display processing like `sample_display_processing`, but from a loaded table.

    Parameters
    ----------
    table : DisplayProcessing
        Default display processing and distributions of its parameters.
    rng : numpy.random.Generator
        Generator; the only source of randomness.

    Returns
    -------
    FlatPanelProcessing
        Sampled display processing.
    """
    spread = table.spread
    scores = np.clip(rng.standard_normal(5), -_TRUNCATION_SD, _TRUNCATION_SD)
    gains = (spread.latitude_gain, spread.edge_gain)
    if rng.random() < spread.weakly_processed_fraction:
        gains = (spread.plain_latitude_gain, spread.plain_edge_gain)
    laws = (*gains, spread.dark, spread.bright, spread.bend)
    latitude, edge, dark, bright, bend = (
        round(float(np.clip(law.mean + law.sd * score, law.low, law.high)), 4)
        for law, score in zip(laws, scores, strict=True)
    )
    return msgspec.structs.replace(
        table.processed,
        latitude_gain=latitude,
        edge_gain=round(float(np.exp(edge)), 4),
        edge_mm=spread.edge_mm,
        dark=dark,
        bright=bright,
        bend=bend,
    )
