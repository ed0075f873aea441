"""Datasheet and citation file of the data set."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jinja2
import pandas as pd

from ..data.analysis.benchmark_table import BenchmarkDefinition
from ..study.learn.benchmark_baselines import PREDICTORS


@dataclass(frozen=True, kw_only=True)
class DatasheetContent:
    """Content of the datasheet.

    Attributes
    ----------
    dataset_spec : BenchmarkDefinition
        Definition of the data set: preset, seed, splits, version, title and licence.
    manifest : DataFrame
        Manifest of the images, one row per radiograph.
    total_subjects : int
        Number of subjects in the complete data set.
    variant : str
        Names of the replaced preset entries; an empty string for the unmodified data set.
    unlocated_radiographs : int
        Number of radiographs in which the joint was not located.
    reference_protocol : str
        Protocol of the radiographs on which the baselines are trained.
    baselines : DataFrame
        Scores of the baselines (`BenchmarkResult.baselines`).
    notes : sequence of str
        Notes on missing baselines and on splits with too few subjects.
    warnings : sequence of str
        Warnings from `study.statistics.analyses.leakage_checks.find_leakage_warnings`.
    versions : mapping of str to str
        Versions of the package and of the libraries that affect the pixels.
    """

    dataset_spec: BenchmarkDefinition
    manifest: pd.DataFrame
    total_subjects: int
    variant: str
    unlocated_radiographs: int
    reference_protocol: str
    baselines: pd.DataFrame
    notes: Sequence[str]
    warnings: Sequence[str]
    versions: Mapping[str, str]


def render_datasheet(content: DatasheetContent) -> str:
    """Render the datasheet in Markdown with the headings of Gebru et al. (2021).

    Parameters
    ----------
    content : DatasheetContent
        Content of the datasheet.

    Returns
    -------
    str
        Markdown text.
    """
    manifest, knees = content.manifest, content.manifest.drop_duplicates("knee")
    of_subject = knees.groupby("subject").size()
    counted = {"subjects": ("subject", "nunique"), "knees": ("knee", "nunique"), "radiographs": ("knee", "size")}
    columns = ["protocol", "beam_angle_deg", "mas", "tube_kv"]
    first = manifest.iloc[0]
    return _render_template(
        "datasheet.md.j2",
        frozen=content.dataset_spec,
        whole=content.total_subjects,
        variant=content.variant,
        subjects=len(of_subject),
        pairs=int((of_subject > 1).sum()),
        knees=len(knees),
        radiographs=len(manifest),
        rows=int(first["rows"]),
        cols=int(first["cols"]),
        pixel_mm=f"{first['pixel_mm']:g}",
        grades=manifest.groupby("grade").agg(**counted).reset_index().to_dict("records"),
        protocols=manifest[columns].drop_duplicates("protocol").to_dict("records"),
        splits=content.dataset_spec.splits,
        versions=content.versions,
        refused=content.unlocated_radiographs,
        reference=content.reference_protocol,
        baselines=[_format_baseline_row(row) for row in content.baselines.to_dict("records")],
        notes=content.notes,
        warnings=content.warnings,
    )


def render_citation(frozen: BenchmarkDefinition, versions: Mapping[str, str]) -> str:
    """Render the citation file of the data set (Citation File Format 1.2.0).

    Parameters
    ----------
    frozen : BenchmarkDefinition
        Definition of the data set.
    versions : mapping of str to str
        Versions by package name; the version of this package has the key ``pssf``.

    Returns
    -------
    str
        Text of CITATION.cff.
    """
    return _render_template("citation.cff.j2", frozen=frozen, versions=versions)


def _render_template(template: str, **values: Any) -> str:
    """Render a template of the subpackage `benchmark`. An undefined variable raises an error."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("pssf.benchmark", "."),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(**values)


def _format_baseline_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """Format the scores of one baseline, with its label and its 95 % confidence interval."""
    interval = "" if pd.isna(row["auc_low"]) else f"{row['auc_low']:.2f} to {row['auc_high']:.2f}"
    scores = {name: "" if pd.isna(row[name]) else f"{row[name]:.2f}" for name in ("auc", "balanced_accuracy")}
    return {**row, **scores, "label": PREDICTORS[row["model"]], "interval": interval}
