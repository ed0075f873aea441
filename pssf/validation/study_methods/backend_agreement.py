"""Agreement between the radiomics backends MIRP and PyRadiomics, by feature family.

The two backends must be installed (dependency group ``peers``, Python 3.11).
"""

from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ...core.checks import InputError
from ...data.analysis.ibsi_table import load_ibsi_tags
from ...model.protocol import load_protocol
from ...model.sampling.knee_sampling import sample_knee
from ...radiomics.features.feature_backends import BACKENDS, is_installed
from ...radiomics.features.feature_extraction import extract_features
from ...radiomics.features.feature_families import FAMILIES
from ...radiomics.features.ibsi_tags import IbsiTags
from ...radiomics.features.mirp_backend import MirpExtractor
from ...radiomics.localisation.region_of_interest import cut_region
from ...simulation import simulate
from ..raycasting.raycast_engines import Row

_PROTOCOLS = ("reference", "low_dose", "geometry_shift")
# Edge length of a region, in pixels.
_REGION_PX = 512
# Number of grey-level bins.
_BINS = 64
# Magnitude below which a feature is not compared because it is a rounding error, such as the mean of a z-score.
_ROUNDING_ERROR = 1e-9


def compare_backends() -> list[Row]:
    """Compare features and run time of the two radiomics backends by feature family.

    Returns
    -------
    list of dict
        One row per family: number of features that both backends have (``both``), and names of features that only one
        backend has. ``by`` is the code that computes the family if MIRP is selected. ``apart`` is the largest relative
        difference. ``pyradiomics_s`` and ``mirp_s`` are seconds per region.

    Raises
    ------
    InputError
        A backend is not installed.
    """
    missing = [name for name in BACKENDS if not is_installed(name)]
    if missing:
        raise InputError(
            "table backends needs MIRP and PyRadiomics, "
            f"but the installation lacks {', '.join(missing)}: use `uv run --group peers`"
        )
    tags, regions = load_ibsi_tags(), [_simulate_region(grade, name) for grade, name in enumerate(_PROTOCOLS)]
    for name in BACKENDS:
        extract_features(regions[0], 1.0, tags, backend=name)  # The first, untimed run includes the import.
    return [_compare_family(family, regions, MirpExtractor(tags)) for family in FAMILIES]


def _simulate_region(grade: int, name: str) -> NDArray[np.uint16]:
    """Simulate a radiograph of a sampled knee and cut out a (512, 512) region around the medial joint line, in DN."""
    protocol = load_protocol(name)
    knee = sample_knee(grade=grade, rng=np.random.default_rng(grade), grade_table="paper")
    radiograph = simulate(knee, protocol, rng=grade, engine="scanline")
    assert radiograph.truth is not None
    return cut_region(radiograph.pixels, *radiograph.truth.medial_joint_line_px, _REGION_PX).astype(np.uint16)


def _compare_family(family: str, regions: list[NDArray[np.uint16]], mirp: MirpExtractor) -> Row:
    """Compare the features of one family between the two backends."""
    first, second = (_time_extraction(family, regions, mirp.tags, name) for name in BACKENDS)
    apart = 0.0
    for one, other in zip(first[0], second[0], strict=True):
        shared = [name for name in one if name in other and abs(one[name]) > _ROUNDING_ERROR]
        apart = max([apart, *(abs(other[name] / one[name] - 1) for name in shared)])
    names, theirs = ({name.rsplit("_", 1)[1]: name for name in values[0][0]} for values in (first, second))
    return {
        "family": family,
        "both": len(set(names) & set(theirs)),
        "apart": apart,
        "only_pyradiomics": ", ".join(name for name in names if name not in theirs),
        "only_mirp": ", ".join([] if family == "shape2D" else mirp.list_unused_tags(family, regions[0], _BINS)),
        "by": "pssf" if family == "shape2D" else "mirp",
        "pyradiomics_s": first[1],
        "mirp_s": second[1],
    }


def _time_extraction(
    family: str, regions: list[NDArray[np.uint16]], tags: IbsiTags, backend: str
) -> tuple[list[dict[str, float]], float]:
    """Extract the features of every region; return the features and the shortest time per region in seconds."""
    values, seconds = [], []
    for region in regions:
        began = perf_counter()
        values.append(extract_features(region, 1.0, tags, _BINS, (family,), backend))
        seconds.append(perf_counter() - began)
    return values, min(seconds)
