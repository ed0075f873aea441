"""Croissant 1.0 metadata of the data set."""

from collections.abc import Mapping, Sequence
from typing import Any

from ..data.analysis.benchmark_table import BenchmarkDefinition
from ..io import croissant_elements
from ..io.croissant_elements import CONFORMS_TO, SPLIT_URLS

# Data type and description of each column of manifest.csv.
_RADIOGRAPH_COLUMNS = {
    "radiograph": ("sc:Text", "Name of the radiograph."),
    "subject": ("sc:Integer", "Subject number; the data are split by subject."),
    "knee": ("sc:Integer", "Knee number."),
    "side": ("sc:Text", "Side of the knee, right or left."),
    "sex": ("sc:Text", "Sex, female or male."),
    "age_years": ("sc:Float", "Age, years."),
    "stature_mm": ("sc:Float", "Stature, mm."),
    "grade": ("sc:Integer", "Label: Kellgren-Lawrence grade of the sampled knee, 0 to 4."),
    "jsw_medial_mm": ("sc:Float", "Minimum medial joint space width on this radiograph, mm."),
    "jsw_lateral_mm": ("sc:Float", "Minimum lateral joint space width on this radiograph, mm."),
    "nominal_jsw_medial_mm": ("sc:Float", "Specified medial joint space width of the knee, mm."),
    "nominal_jsw_lateral_mm": ("sc:Float", "Specified lateral joint space width of the knee, mm."),
    "protocol": ("sc:Text", "Name of the protocol, which includes beam tilt and dose."),
    "beam_angle_deg": ("sc:Float", "Beam angle, degrees; positive is caudal."),
    "tube_kv": ("sc:Float", "Peak tube voltage, kV."),
    "mas": ("sc:Float", "Tube current-time product, mAs; proportional to the dose."),
    "pixel_mm": ("sc:Float", "Pixel pitch on the detector, mm."),
    "truth_medial_row_px": ("sc:Float", "Row of the centre of the medial joint space, pixels."),
    "truth_medial_col_px": ("sc:Float", "Column of the centre of the medial joint space, pixels."),
    "sha256": ("sc:Text", "SHA-256 hash of the image file."),
}
# Data type and description of each column of splits.csv.
_SPLIT_COLUMNS = {
    "repeat": ("sc:Integer", "Split number."),
    "subject": ("sc:Integer", "Subject number."),
    "part": ("sc:Text", "Subset of the split: training, validation or test."),
}


def build_croissant_metadata(
    frozen: BenchmarkDefinition, files: Mapping[str, tuple[str, int]], columns: Sequence[str]
) -> dict[str, Any]:
    """Build the Croissant metadata of the data set.

    Parameters
    ----------
    frozen : BenchmarkDefinition
        Definition of the data set: title, version, licence and date.
    files : mapping of str to (str, int)
        SHA-256 hash and size in bytes of each CSV file; manifest.csv and splits.csv are required.
    columns : sequence of str
        Columns of manifest.csv to describe.

    Returns
    -------
    dict of str to object
        JSON-ready metadata.
    """
    known = {name: what for name, what in _RADIOGRAPH_COLUMNS.items() if name in columns}
    return {
        "@context": croissant_elements.build_context(),
        "@type": "sc:Dataset",
        "conformsTo": CONFORMS_TO,
        "name": frozen.preset,
        "description": f"{frozen.title}. {frozen.description}",
        "version": frozen.version,
        "license": frozen.license,
        "url": frozen.url,
        "creator": {"@type": "sc:Organization", "name": frozen.creator},
        "datePublished": frozen.date,
        "keywords": list(frozen.keywords),
        "citeAs": f"@misc{{{frozen.preset}, title = {{{frozen.title}}}, author = {{{{{frozen.creator}}}}}, "
        f"year = {{{frozen.date[:4]}}}, version = {{{frozen.version}}}}}",
        "isLiveDataset": False,
        "distribution": [
            *(croissant_elements.describe_file(name, *about) for name, about in files.items()),
            _describe_image_set(),
        ],
        "recordSet": [
            _describe_table(
                "radiographs", "manifest.csv", known, "One record per radiograph.", [_describe_image_name_field()]
            ),
            _describe_table(
                "splits",
                "splits.csv",
                _SPLIT_COLUMNS,
                "Fixed splits by subject; both knees of a subject are in the same subset.",
            ),
            croissant_elements.describe_split_parts(SPLIT_URLS),
            croissant_elements.describe_images("images", "Pixels of the radiograph."),
        ],
    }


def _describe_image_set() -> dict[str, Any]:
    """Describe the set of images."""
    what = "16-bit TIFF images, linear in the absorbed energy, with row 0 proximal; manifest.csv lists their hashes."
    return croissant_elements.describe_file_set("images", "image/tiff", "images/*.tif", what)


def _describe_table(
    name: str,
    file: str,
    columns: Mapping[str, tuple[str, str]],
    description: str,
    extra_fields: Sequence[dict[str, Any]] = (),
) -> dict[str, Any]:
    """Describe a CSV table with its columns and additional fields."""
    fields = []
    for column, (kind, what) in columns.items():
        fields.append(croissant_elements.describe_column(name, file, column, kind, what))
        if column == "part":
            fields[-1]["references"] = {"field": {"@id": "parts/name"}}
    held = {"@type": "cr:RecordSet", "@id": name, "name": name, "description": description}
    return (
        held
        | ({"key": {"@id": f"{name}/radiograph"}} if "radiograph" in columns else {})
        | {"field": [*fields, *extra_fields]}
    )


def _describe_image_name_field() -> dict[str, Any]:
    """Describe the field that links a radiograph to its image file."""
    source = {
        "fileObject": {"@id": "manifest.csv"},
        "extract": {"column": "file"},
        "transform": {"regex": "images/(.*)"},
    }
    # The field does not refer to images_by_name, because a loader would then read every image to list the labels.
    return croissant_elements.describe_field(
        "radiographs/image", "sc:Text", "File name of the image; it is the key of images_by_name.", source
    )
