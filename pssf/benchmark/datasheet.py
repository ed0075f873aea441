"""What a reader should know of the data set before it is used, as a page; and how it is cited."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jinja2
import pandas as pd

from ..data.benchmark import FrozenSet
from ..study.learn.frozen import PREDICTORS


@dataclass(frozen=True, kw_only=True)
class About:
    """What the datasheet is about.

    whole      people of the whole data set
    variant    what was asked for instead of what the data set has; "" where it is the one
    refused    radiographs whose joint was not found
    reference  protocol that baselines learn from
    baselines  of `make.make_benchmark`
    notes      sentences on baselines that are not there
    warnings   of `provenance.warnings_of`
    """

    frozen: FrozenSet
    manifest: pd.DataFrame
    whole: int
    variant: str
    refused: int
    reference: str
    baselines: pd.DataFrame
    notes: Sequence[str]
    warnings: Sequence[str]
    versions: Mapping[str, str]


def datasheet(about: About) -> str:
    """The page, in Markdown, under the headings of Gebru 2021."""
    manifest, knees = about.manifest, about.manifest.drop_duplicates("knee")
    of_subject = knees.groupby("subject").size()
    counted = {"people": ("subject", "nunique"), "knees": ("knee", "nunique"), "radiographs": ("knee", "size")}
    columns = ["protocol", "beam_angle_deg", "mas", "tube_kv"]
    first = manifest.iloc[0]
    return _rendered(
        "datasheet.md.j2",
        frozen=about.frozen,
        whole=about.whole,
        variant=about.variant,
        people=len(of_subject),
        pairs=int((of_subject > 1).sum()),
        knees=len(knees),
        radiographs=len(manifest),
        rows=int(first["rows"]),
        cols=int(first["cols"]),
        pixel_mm=f"{first['pixel_mm']:g}",
        grades=manifest.groupby("grade").agg(**counted).reset_index().to_dict("records"),
        protocols=manifest[columns].drop_duplicates("protocol").to_dict("records"),
        splits=about.frozen.splits,
        versions=about.versions,
        refused=about.refused,
        reference=about.reference,
        baselines=[_shown(row) for row in about.baselines.to_dict("records")],
        notes=about.notes,
        warnings=about.warnings,
    )


def citation(frozen: FrozenSet, versions: Mapping[str, str]) -> str:
    """The Citation File Format of the data set."""
    return _rendered("citation.cff.j2", frozen=frozen, versions=versions)


def _rendered(template: str, **values: Any) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("pssf.benchmark", "."),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(**values)


def _shown(row: Mapping[str, Any]) -> dict[str, Any]:
    interval = "" if pd.isna(row["auc_low"]) else f"{row['auc_low']:.2f} to {row['auc_high']:.2f}"
    scores = {name: "" if pd.isna(row[name]) else f"{row[name]:.2f}" for name in ("auc", "balanced_accuracy")}
    return {**row, **scores, "label": PREDICTORS[row["model"]], "interval": interval}
