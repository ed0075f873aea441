"""Study state: inputs, features, predictions and tables that the study stages pass on as one object."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from ..core.processes.execution import Execution
from ..model.sampling.knee_sampling import KneeDistributions
from ..radiomics.features.feature_table import LoadPixels
from ..radiomics.localisation.templates import Template
from .design.response_curve_design import DesignedManifests
from .design.study_settings import StudySettings
from .design.study_tables import StudyTables
from .predictions import SplitOutcome, concatenate_tables

Tables = dict[str, pd.DataFrame]


@dataclass(frozen=True)
class StudyContext:
    """Inputs, settings and execution that all study stages share.

    Parameters
    ----------
    load_pixels : callable
        Function that returns (rows, cols) uint16 pixels, linear in the signal, for an entry of the column ``file``.
    templates : sequence of Template
        Radiographs of standard knees; the knee with the widest joint space is first.
    settings : StudySettings
        Settings of the study.
    out : Path
        Output folder.
    execution : Execution
        Workers, scheduler, timer and progress bar.
    tables : StudyTables
        Data tables of the package that the study reads.
    load_masks : callable, optional
        Function that returns bone masks by name, each (rows, cols) bool, for an entry of the column ``masks`` of the
        repeat radiographs; None if there are no masks.
    """

    load_pixels: LoadPixels
    templates: Sequence[Template]
    settings: StudySettings
    out: Path
    execution: Execution
    tables: StudyTables
    load_masks: Callable[[str], Mapping[str, Any]] | None = None


@dataclass(frozen=True, kw_only=True)
class StudyData:
    """Radiographs, features, predictions and tables of a study.

    Each study stage returns a new object that includes its results: `replace` adds the predictions of the splits, and
    `add_tables` adds tables.

    Parameters
    ----------
    run : StudyContext
        Inputs, settings and execution.
    manifest : DataFrame
        Checked manifest of the cohort, one row per radiograph.
    parameters : DataFrame
        True parameters, one row per knee; see `knee_parameters.extract_knee_parameters`.
    located : DataFrame
        Cohort radiographs with region, localisation error and features.
    repeated : DataFrame
        Repeat radiographs with a located region: kind, repeat_index, knee and features.
    names : list of str
        Names of the features.
    laws : KneeDistributions or None
        Distributions from which the knees were sampled; None if they are unknown.
    designed : DesignedManifests
        Manifests of designed radiographs; analyses without their manifest are omitted.
    outcomes : sequence of SplitOutcome
        Predictions and tables of each split; empty before training.
    tables : dict of str to DataFrame
        Result tables of the finished stages, keyed by CSV file name without suffix.
    """

    run: StudyContext
    manifest: pd.DataFrame
    parameters: pd.DataFrame
    located: pd.DataFrame
    repeated: pd.DataFrame
    names: list[str]
    laws: KneeDistributions | None = None
    designed: DesignedManifests = field(default_factory=DesignedManifests)
    outcomes: Sequence[SplitOutcome] = ()
    tables: Tables = field(default_factory=dict)

    @property
    def settings(self) -> StudySettings:
        """Settings of the study."""
        return self.run.settings

    @cached_property
    def usable(self) -> pd.DataFrame:
        """Cohort radiographs with a located region."""
        return self.located[self.located["status"] == "found"]

    @cached_property
    def base(self) -> pd.DataFrame:
        """Cohort radiographs with a located region under the reference protocol."""
        return self.usable[self.usable["protocol"] == self.settings.reference]

    @cached_property
    def predictions(self) -> pd.DataFrame:
        """Predictions of all splits."""
        return self.stack("predictions")

    def stack(self, name: str) -> pd.DataFrame:
        """Concatenate a table of `SplitOutcome` over all splits.

        Parameters
        ----------
        name : str
            Name of a field of `SplitOutcome`.

        Returns
        -------
        DataFrame
            Rows of all splits, in order.
        """
        return concatenate_tables(getattr(outcome, name) for outcome in self.outcomes)

    def add_tables(self, tables: Tables) -> "StudyData":
        """Add tables to a copy of the study data; existing tables with the same name are replaced.

        Parameters
        ----------
        tables : dict of str to DataFrame
            Tables to add.

        Returns
        -------
        StudyData
            Study data with the added tables.
        """
        return replace(self, tables=self.tables | tables)
