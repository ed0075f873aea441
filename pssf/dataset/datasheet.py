"""Datasheet of a data set, with the headings of Gebru et al. 2021 (Commun ACM 64:86)."""

from collections.abc import Mapping

from .dataset_settings import SPLITS, DatasetSettings
from .dataset_summary import IndexSummary
from .dataset_tables import DatasetTables

_TEXT = """# Datasheet

{images} simulated knee radiographs of {people} people. The headings follow Gebru et al., Datasheets for datasets
(Communications of the ACM, 2021).

## Motivation

The data set is for the training and test of methods that read knee radiographs. Every label is true by construction,
because it is computed from the simulated knee.

## Composition

Each instance is one radiograph. No person was imaged: knees are sampled from the grade table `{grade_table}`, and
images are simulated from physics. A person has {knees} knee(s). Number of images:

| KL grade | {splits} |
| --- |{rules}
{table}

- **Images**: {kinds}; {size}.
- **Protocols**: {protocols}. Acquisition: {acquisition}; X-ray equipment: {equipment}; display processing: {display}.
- **Random transforms** after the simulation: {randomise}.
- **Pairs**: {pairs}.
- **Label maps** (`label_map`): {legend}. Later values cover earlier values; the masks themselves, which may overlap,
  are COCO instances.
- **Labels**: KL grade and grade of a simulated reader, OARSI grades, joint space widths on this image, landmarks,
  alignment, posture, acquisition, and all fields of the knee. A label that a view does not have is missing.
- **Splits** are by person. Names are hashes, so that neither order nor name predicts a label.

The grade is the grade for which a knee was sampled. The anatomy of neighbouring grades overlaps, as in patients, and no
reader has graded the images. An image alone therefore does not determine the grade.

## Collection process

`pssf dataset` made the data set from the seed {seed}. `dataset.json` contains all settings, protocols, versions of
libraries and hashes of code; the same versions make the same bytes. No ethics review applies.

## Preprocessing, cleaning, labelling

No image was removed. If a knee could not be built, the person was sampled again; the label `attempt` counts this.

## Uses

Networks that are trained on these images are not validated for use on patients. Trabeculae are a random field, and
readers can distinguish these images from patient radiographs. Do not use the data set to estimate frequencies in a
population{balance}.

## Distribution and maintenance

Add a licence, a date and an address to `croissant.json` before you publish the data set. Hashes of all files are in
`records`; `pssf dataset verify FOLDER` checks them.
"""


def render_dataset_datasheet(settings: DatasetSettings, tables: DatasetTables, summary: IndexSummary) -> str:
    """Render the datasheet of a data set in Markdown.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.
    tables : DatasetTables
        Tables and protocols.
    summary : IndexSummary
        Numbers of images.

    Returns
    -------
    str
        Text of the datasheet.
    """
    grades = sorted({grade for _, grade in summary.counts})
    rows = [[str(grade), *(str(summary.counts[split, grade]) for split in SPLITS)] for grade in grades]
    crop = f"square crops of {settings.crop_mm:g} mm about the joint" if settings.crop_mm else "whole images"
    return _TEXT.format(
        images=summary.images,
        people=summary.people,
        grade_table=settings.grade_table,
        knees=settings.knees_per_person,
        splits=" | ".join(SPLITS),
        rules=" --- |" * len(SPLITS),
        table="\n".join(f"| {' | '.join(row)} |" for row in rows),
        kinds=", ".join(settings.kinds),
        size=f"{crop}, {settings.matrix} pixels along the longer side" if settings.matrix else crop,
        protocols=", ".join(protocol.name for protocol in tables.protocols),
        acquisition=settings.acquisition,
        equipment=settings.equipment,
        display=settings.display,
        randomise=", ".join(settings.randomise) or "none",
        pairs=settings.pairs,
        legend=_list_values(tables.definitions.label_map),
        seed=settings.seed,
        balance="; the grades are balanced" if settings.grades == "balanced" else "",
    )


def _list_values(values: Mapping[str, int]) -> str:
    """List the values of the label map."""
    return ", ".join(f"{value} {kind.replace('_', ' ')}" for kind, value in values.items())
