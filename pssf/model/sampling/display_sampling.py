"""Sample display processing, which varies between radiology departments: latitude, sharpness and grey scale."""

import msgspec
import numpy as np

from ...core.checks import RNGLike, resolve_generator
from ...core.keyword_arguments import check_keywords
from ...data.imaging.display_table import DisplayProcessing, FlatPanelProcessing, load_display_processing

# Number of standard deviations at which normal distributions are truncated.
_TRUNCATION_SD = 2.0


@check_keywords()
def sample_display_processing(*, rng: RNGLike) -> FlatPanelProcessing:
    """Sample the display processing of a department: latitude, sharpness, and both ends of the grey scale.

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
    The distributions and their source are in ``data/looks.toml``.

    Examples
    --------
    >>> import pssf
    >>> processing = pssf.sample_display_processing(rng=7)
    >>> processing == pssf.sample_display_processing(rng=7)
    True
    """
    return sample_processing_from_table(load_display_processing(), rng=resolve_generator(rng))


def sample_processing_from_table(table: DisplayProcessing, *, rng: np.random.Generator) -> FlatPanelProcessing:
    """Sample display processing from a loaded table, as in `sample_display_processing`.

    Parameters
    ----------
    table : DisplayProcessing
        Default processing and its variability.
    rng : numpy.random.Generator
        Generator; the only source of randomness.

    Returns
    -------
    FlatPanelProcessing
        Sampled parameters.
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
