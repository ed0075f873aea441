"""Datasheet of a data set, with the headings of Gebru et al. 2021 (Commun ACM 64:86)."""

from collections.abc import Mapping

from .dataset_settings import SPLITS, DatasetSettings
from .dataset_summary import IndexSummary
from .dataset_tables import DatasetTables

_TEXT = """# Datasheet

{images} simulated knee radiographs of {subjects} subjects. The headings follow Gebru et al., Datasheets for datasets
(Communications of the ACM, 2021).

## Motivation

The data set is for training and testing methods that analyse knee radiographs. Except for the grade of the simulated
reader, every label is computed from the simulated knee, and therefore true by construction.

## Composition

Each instance is one radiograph. No person was imaged: knees are sampled from the grade table `{grade_table}`, and
images are simulated with a physical model. Imaged knees per subject: {knees}. Number of images by KL grade and subset:

| KL grade | {splits} |
| --- |{rules}
{table}

- **Images**: {kinds}; {size}.
- **Protocols**: {protocols}. Acquisition: {acquisition}; X-ray equipment: {equipment}; display processing: {display}.
- **Random transforms** after the simulation: {randomise}. All except `affine` change only 8-bit images.
- **Pairs**: {pairs}.
- **Label maps** (`label_map`): {legend}. Later values cover earlier values; the masks themselves, which may overlap,
  are COCO instances.
- **Labels**: KL grade and grade of a simulated reader, OARSI grades, joint space widths on this image, landmarks,
  alignment, posture, acquisition, and all fields of the knee. A label that a view does not have is missing.
- **Subsets** are divided by subject. Names are hashes, and the order of the grades is random, so that neither name nor
  order predicts a label.

The KL grade is the grade for which a knee was sampled. In lesion and visit pairs, the grade of the second image follows
from the changed anatomy. The anatomy of neighbouring grades overlaps, as in patients, so that an image alone does not
determine the grade. No human reader graded the images.

## Collection process

`pssf dataset` made the data set from the seed {seed}. `dataset.json` contains all settings, protocols, versions of
libraries and hashes of code. The same settings, code and library versions give byte-identical files. No ethics review
applies.

## Preprocessing, cleaning, labelling

No simulated image was removed. If a knee could not be built, the subject was sampled again; the label `attempt` counts
failed attempts.

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
    crop = f"square crops of {settings.crop_mm:g} mm around the joint" if settings.crop_mm else "whole images"
    return _TEXT.format(
        images=summary.images,
        subjects=summary.subjects,
        grade_table=settings.grade_table,
        knees=settings.knees_per_subject,
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
        balance=", because its grades are balanced" if settings.grades == "balanced" else "",
    )


def _list_values(values: Mapping[str, int]) -> str:
    """List the values of the label map."""
    return ", ".join(f"{value} {kind.replace('_', ' ')}" for kind, value in values.items())
