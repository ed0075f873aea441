"""Croissant 1.0 metadata of the data set, a JSON-LD format of MLCommons (mlcommons.org/croissant/1.0)."""

from collections.abc import Mapping, Sequence
from typing import Any

from ..data.analysis.benchmark_table import BenchmarkDefinition

# Standard to which the metadata conforms.
CONFORMS_TO = "http://mlcommons.org/croissant/1.0"
# Identifier in the Croissant vocabulary for each subset of a split.
_SPLIT_URLS = {"training": "cr:TrainingSplit", "validation": "cr:ValidationSplit", "test": "cr:TestSplit"}
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
        "@context": _build_context(),
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
        "distribution": [*(_describe_file(name, *about) for name, about in files.items()), _describe_image_set()],
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
            _describe_split_parts(),
            _describe_image_records(),
        ],
    }


def _describe_file(name: str, sha256: str, size: int) -> dict[str, Any]:
    """Describe one CSV file."""
    about = {"contentUrl": name, "contentSize": f"{size} B", "encodingFormat": "text/csv", "sha256": sha256}
    return {"@type": "cr:FileObject", "@id": name, "name": name, **about}


def _describe_image_set() -> dict[str, Any]:
    """Describe the set of images."""
    what = "16-bit TIFF images, linear in the absorbed energy, with row 0 proximal; manifest.csv lists their hashes."
    where = {"encodingFormat": "image/tiff", "includes": "images/*.tif"}
    return {"@type": "cr:FileSet", "@id": "images", "name": "images", "description": what, **where}


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
        source = {"fileObject": {"@id": file}, "extract": {"column": column}}
        fields.append(_describe_field(f"{name}/{column}", kind, what, source))
        if column == "part":
            fields[-1]["references"] = {"field": {"@id": "parts/name"}}
    held = {"@type": "cr:RecordSet", "@id": name, "name": name, "description": description}
    return (
        held
        | ({"key": {"@id": f"{name}/radiograph"}} if "radiograph" in columns else {})
        | {"field": [*fields, *extra_fields]}
    )


def _describe_field(identity: str, kind: str, description: str, source: dict[str, Any] | None = None) -> dict[str, Any]:
    """Describe one field of a record set."""
    about = {"@type": "cr:Field", "@id": identity, "name": identity, "description": description, "dataType": kind}
    return about if source is None else about | {"source": source}


def _describe_image_name_field() -> dict[str, Any]:
    """Describe the field that links a radiograph to its image file."""
    source = {
        "fileObject": {"@id": "manifest.csv"},
        "extract": {"column": "file"},
        "transform": {"regex": "images/(.*)"},
    }
    # The field does not refer to images_by_name, because a loader would then read every image to list the labels.
    return _describe_field(
        "radiographs/image", "sc:Text", "File name of the image; it is the key of images_by_name.", source
    )


def _describe_image_records() -> dict[str, Any]:
    """Describe the record set of all images, keyed by file name."""
    said = {"name": "images_by_name", "description": "All images, keyed by file name."}
    of_name, of_content = (
        {"fileSet": {"@id": "images"}, "extract": {"fileProperty": what}} for what in ("filename", "content")
    )
    fields = [
        _describe_field("images_by_name/name", "sc:Text", "File name of the image.", of_name),
        _describe_field("images_by_name/content", "sc:ImageObject", "Pixels of the radiograph.", of_content),
    ]
    key = {"@id": "images_by_name/name"}
    return {"@type": "cr:RecordSet", "@id": "images_by_name", **said, "key": key, "field": fields}


def _describe_split_parts() -> dict[str, Any]:
    """Describe the subsets of a split: training, validation and test."""
    fields = [
        _describe_field("parts/name", "sc:Text", "Name of the subset."),
        _describe_field("parts/url", "sc:URL", "Purpose of the subset, as an identifier of the Croissant vocabulary."),
    ]
    data = [{"parts/name": name, "parts/url": url} for name, url in _SPLIT_URLS.items()]
    said = {"name": "parts", "description": "Subsets of a split.", "dataType": "cr:Split", "key": {"@id": "parts/name"}}
    return {"@type": "cr:RecordSet", "@id": "parts", **said, "field": fields, "data": data}


def _build_context() -> dict[str, Any]:
    """Build the JSON-LD context that appendix 1 of the Croissant specification recommends."""
    terms = (
        *("citeAs", "column", "extract", "field", "fileProperty", "fileObject", "fileSet", "format", "includes"),
        *("equivalentProperty", "isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet"),
        *("references", "regex", "repeated", "replace", "samplingRate", "separator", "source", "subField", "transform"),
    )
    spaces = {"cr": "http://mlcommons.org/croissant/", "dct": "http://purl.org/dc/terms/", "sc": "https://schema.org/"}
    spaces["rai"] = "http://mlcommons.org/croissant/RAI/"
    typed = {name: {"@id": f"cr:{name}", "@type": "@json"} for name in ("data", "examples")}
    typed["dataType"] = {"@id": "cr:dataType", "@type": "@vocab"}
    plain = {name: f"cr:{name}" for name in terms} | {"conformsTo": "dct:conformsTo"}
    return {"@language": "en", "@vocab": "https://schema.org/", **spaces, **plain, **typed}
