"""Features by MIRP beside those by pyradiomics, family by family: which one has and the other lacks, how far they are
apart, and what they cost (needs both: the group "peers", on Python 3.11)."""

from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ..core.checks import InputError
from ..data.ibsi import ibsi_tags
from ..model.draw import draw_knee
from ..model.protocol import load_protocol
from ..radiomics.backends import BACKENDS, is_installed
from ..radiomics.by_mirp import Mirp
from ..radiomics.families import FAMILIES
from ..radiomics.features import extract
from ..radiomics.ibsi import Tags
from ..radiomics.region import cut_region
from ..simulation import simulate
from .engines import Row

_PROTOCOLS = ("reference", "low_dose", "geometry_shift")
_REGION_PX = 512
_BINS = 64
# The mean of a z-score is nothing but rounding.
_ROUNDING = 1e-9


def backend_rows() -> list[Row]:
    """One row a family: features of both, of one alone, by whom, largest relative difference, seconds of a region.

    raises  InputError where either is not installed
    """
    missing = [name for name in BACKENDS if not is_installed(name)]
    if missing:
        raise InputError(f"backends = without {', '.join(missing)}; allowed: both, as uv run --group peers has them")
    tags, regions = ibsi_tags(), [_region(grade, name) for grade, name in enumerate(_PROTOCOLS)]
    for name in BACKENDS:
        extract(regions[0], 1.0, tags, backend=name)  # imports are nobody's cost
    return [_row(family, regions, Mirp(tags)) for family in FAMILIES]


def _region(grade: int, name: str) -> NDArray[np.uint16]:
    """(512, 512) DN, about the medial joint line of a drawn knee"""
    protocol = load_protocol(name)
    knee = draw_knee(grade=grade, rng=np.random.default_rng(grade), grade_table="paper")
    radiograph = simulate(knee, protocol, rng=grade, engine="scanline")
    assert radiograph.truth is not None
    return cut_region(radiograph.pixels, *radiograph.truth.medial_joint_line_px, _REGION_PX).astype(np.uint16)


def _row(family: str, regions: list[NDArray[np.uint16]], mirp: Mirp) -> Row:
    first, second = (_timed(family, regions, mirp.tags, name) for name in BACKENDS)
    apart = 0.0
    for one, other in zip(first[0], second[0], strict=True):
        shared = [name for name in one if name in other and abs(one[name]) > _ROUNDING]
        apart = max([apart, *(abs(other[name] / one[name] - 1) for name in shared)])
    names, theirs = ({name.rsplit("_", 1)[1]: name for name in values[0][0]} for values in (first, second))
    return {
        "family": family,
        "both": len(set(names) & set(theirs)),
        "apart": apart,
        "only_pyradiomics": ", ".join(name for name in names if name not in theirs),
        "only_mirp": ", ".join([] if family == "shape2D" else mirp.beside(family, regions[0], _BINS)),
        "by": "pssf" if family == "shape2D" else "mirp",
        "pyradiomics_s": first[1],
        "mirp_s": second[1],
    }


def _timed(
    family: str, regions: list[NDArray[np.uint16]], tags: Tags, backend: str
) -> tuple[list[dict[str, float]], float]:
    """The features of every region, and the least seconds that one took."""
    values, seconds = [], []
    for region in regions:
        began = perf_counter()
        values.append(extract(region, 1.0, tags, _BINS, (family,), backend))
        seconds.append(perf_counter() - began)
    return values, min(seconds)
