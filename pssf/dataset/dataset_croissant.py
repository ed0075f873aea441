"""Croissant 1.0 metadata of a data set (see `io.croissant_elements`)."""

from typing import Any

from ..io import croissant_elements
from ..io.dataset_files import name_sample_file
from .dataset_settings import DatasetSettings
from .dataset_summary import BOOLEAN, DECIMAL, INTEGER, TEXT, IndexSummary

# Data type of each kind of column.
_TYPES = {BOOLEAN: "sc:Boolean", INTEGER: "sc:Integer", DECIMAL: "sc:Float", TEXT: "sc:Text"}
_SPLIT_URLS = {"train" if name == "training" else name: url for name, url in croissant_elements.SPLIT_URLS.items()}
# Meaning of the most important columns of index.csv.
_COLUMNS = {
    "name": "Name of the image, and of its files.",
    "subject": "Subject; all images of a subject are in the same subset.",
    "split": "Subset.",
    "rows": "Number of rows, pixels.",
    "cols": "Number of columns, pixels.",
    "pixel_mm": "Pixel size on the detector, mm.",
    "side": "Side of the knee, right or left.",
    "sex": "Sex, female or male.",
    "age_years": "Age, years.",
    "bmi": "Body mass index, kg/m2.",
    "kl": "Kellgren-Lawrence grade, 0 to 4.",
    "kl_read": "Kellgren-Lawrence grade of a simulated reader.",
    "jsw_medial_mm": "Minimum medial joint space width on this image, mm.",
    "jsw_lateral_mm": "Minimum lateral joint space width on this image, mm.",
    "protocol": "Name of the protocol.",
    "seed": "Seed of the noise.",
    "appearance_seed": "Seed of crop, display processing and randomisation.",
    "display": "Display processing of the 8-bit image.",
    "warnings": "Warnings of the simulation, as JSON.",
    "randomised": "Names of the random transforms, some of which act only with a certain probability, as JSON.",
    "affine_matrix": "Matrix from (row, column) before to after the affine transform, as JSON.",
    "affine_offset_px": "Offset added after the matrix, pixels, as JSON.",
    "crop_top_px": "First row of the crop in the whole image, pixels.",
    "crop_left_px": "First column of the crop in the whole image, pixels.",
    "crop_whole_rows": "Number of rows of the whole image, pixels.",
    "crop_whole_cols": "Number of columns of the whole image, pixels.",
    "pair": "Name that the two images of a pair share.",
    "role": "Position of the image in its pair, first or second.",
    "attempt": "Number of failed attempts to build the knees of this subject.",
    "file": "Shard that contains the image.",
}
# Meaning of other columns, keyed by the beginning or end of their names.
_PREFIXES = {
    "jsw_at_mm_": "Joint space width, mm, at a fraction of the femoral width: JSW(x), x =",
    "readings_": "Grade, angle or ratio of the knee:",
    "attrition_mm_": "Depth of wear of the plateau, mm:",
    "acquisition_": "Parameter of the acquisition:",
    "technique_": "Parameter of the X-ray equipment:",
    "display_": "Parameter of the display processing:",
    "change_": "Difference between the two images of a pair:",
    "knee_": "Field of the knee:",
}


def build_croissant_metadata(
    settings: DatasetSettings, summary: IndexSummary, sha256: str, size: int
) -> dict[str, Any]:
    """Build the Croissant metadata of a data set.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.
    summary : IndexSummary
        Columns of index.csv.
    sha256 : str
        SHA-256 hash of index.csv.
    size : int
        Size of index.csv, in bytes.

    Returns
    -------
    dict of str to object
        JSON-ready metadata, without licence, URL and date, which the publisher of a data set adds.
    """
    fields = []
    for column, kind in summary.columns.items():
        described = croissant_elements.describe_column(
            "index", "index.csv", column, _TYPES[kind], _describe_column(column)
        )
        references = {"references": {"field": {"@id": "parts/name"}}} if column == "split" else {}
        fields.append(described | references)
    sets, records = _describe_files(settings)
    table = {"@type": "cr:RecordSet", "@id": "index", "name": "index", "description": "One record per image."}
    return {
        "@context": croissant_elements.build_context(),
        "@type": "sc:Dataset",
        "conformsTo": croissant_elements.CONFORMS_TO,
        "name": "simulated-knee-radiographs",
        "description": f"{summary.images} knee radiographs of {summary.subjects} subjects, simulated by pssf with "
        f"seed {settings.seed}; labels are true by construction. datasheet.md describes the data set.",
        "keywords": ["knee", "radiograph", "osteoarthritis", "simulation"],
        "isLiveDataset": False,
        "distribution": [croissant_elements.describe_file("index.csv", sha256, size), *sets],
        "recordSet": [
            {**table, "key": {"@id": "index/name"}, "field": fields},
            croissant_elements.describe_split_parts(_SPLIT_URLS),
            *records,
        ],
    }


def _describe_column(name: str) -> str:
    """Describe a column of index.csv."""
    if name in _COLUMNS:
        return _COLUMNS[name]
    for ending, what in (("_row_px", "Row"), ("_col_px", "Column")):
        if name.endswith(ending):
            return f"{what} of the landmark {name.removesuffix(ending)}, pixels."
    for prefix, what in _PREFIXES.items():
        if name.startswith(prefix):
            return f"{what} {name.removeprefix(prefix)}."
    return f"{name.replace('_', ' ').capitalize()}."


def _describe_files(settings: DatasetSettings) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Describe the sets of files, and the record sets of images."""
    if settings.layout == "shards":
        text = "Shards in WebDataset format; the files of one image have the same name up to the first dot."
        return [croissant_elements.describe_file_set("shards", "application/x-tar", "*/*.tar", text)], []
    kinds = {
        "linear": ("image/tiff", "16-bit images, linear in the absorbed energy."),
        "display": ("image/png", "8-bit images, processed for display."),
        "label_map": ("image/png", "Label maps."),
    }
    images = {kind: about for kind, about in kinds.items() if kind in (*settings.kinds, "label_map")}
    labels = {"labels": ("application/json", "Labels, landmarks and COCO instances of each image.")}
    sets = [
        croissant_elements.describe_file_set(kind, media, name_sample_file("*", kind, "*"), text)
        for kind, (media, text) in (images | labels).items()
    ]
    return sets, [croissant_elements.describe_images(kind, text) for kind, (_, text) in images.items()]
