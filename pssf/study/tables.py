"""StudyTables: what the package's tables give a study, resolved where it begins and carried by its `Run`."""

from collections.abc import Mapping
from dataclasses import dataclass

import pandas as pd

from ..core.checks import InputError
from ..data.landmarks import landmark_reference
from ..data.records import Triple
from ..data.reporting import Guideline, guidelines
from ..model.draw import DrawLaws, draw_laws
from ..radiomics.tables import RadiomicsTables, radiomics_tables


@dataclass(frozen=True, kw_only=True)
class StudyTables:
    """What a study reads.

    radiomics      by which joints are found and features known
    gap_alone_auc  of people's films, see `LandmarkReference`
    guidelines     name -> what its report is to answer
    """

    radiomics: RadiomicsTables
    gap_alone_auc: Mapping[str, Triple]
    guidelines: Mapping[str, Guideline]


def study_tables() -> StudyTables:
    """The package's tables."""
    return StudyTables(
        radiomics=radiomics_tables(), gap_alone_auc=landmark_reference().gap_alone_auc, guidelines=guidelines()
    )


def laws_of(manifest: pd.DataFrame) -> DrawLaws | None:
    """What the knees of a cohort were drawn by; None where its manifest does not tell, or that file is gone."""
    names = set(manifest["grade_table"]) if "grade_table" in manifest else set()
    if len(names) != 1:
        return None
    (name,) = map(str, names)
    try:
        return draw_laws(name)
    except InputError:
        return None
