"""The data set as programs read it: Croissant 1.0, JSON-LD of MLCommons (mlcommons.org/croissant/1.0)."""

from collections.abc import Mapping, Sequence
from typing import Any

from ..data.benchmark import FrozenSet

CONFORMS_TO = "http://mlcommons.org/croissant/1.0"
_SPLITS = {"training": "cr:TrainingSplit", "validation": "cr:ValidationSplit", "test": "cr:TestSplit"}
# Column of manifest.csv -> type, what it is.
_RADIOGRAPH = {
    "radiograph": ("sc:Text", "Name of the radiograph."),
    "subject": ("sc:Integer", "Number of the person; what is split by."),
    "knee": ("sc:Integer", "Number of the knee."),
    "side": ("sc:Text", "right or left."),
    "sex": ("sc:Text", "female or male."),
    "age_years": ("sc:Float", "Age."),
    "stature_mm": ("sc:Float", "Stature, mm."),
    "grade": ("sc:Integer", "Grade like Kellgren and Lawrence's, 0 to 4, that the knee was drawn by: the label."),
    "jsw_medial_mm": ("sc:Float", "Minimum medial joint space width on this radiograph, mm."),
    "jsw_lateral_mm": ("sc:Float", "Minimum lateral joint space width on this radiograph, mm."),
    "nominal_jsw_medial_mm": ("sc:Float", "Medial joint space width that the knee was specified with, mm."),
    "nominal_jsw_lateral_mm": ("sc:Float", "Lateral joint space width that the knee was specified with, mm."),
    "protocol": ("sc:Text", "Name of the technique: which tilt, which dose."),
    "beam_angle_deg": ("sc:Float", "Tilt of the beam, degrees caudally."),
    "tube_kv": ("sc:Float", "Tube voltage, kV."),
    "mas": ("sc:Float", "Tube current and time, mAs: the dose."),
    "pixel_mm": ("sc:Float", "Side of a pixel on the detector, mm."),
    "truth_medial_row_px": ("sc:Float", "Row of the middle of the medial joint line, pixels."),
    "truth_medial_col_px": ("sc:Float", "Its column."),
    "sha256": ("sc:Text", "Hash of the file."),
}
_SPLIT = {
    "repeat": ("sc:Integer", "Number of the split."),
    "subject": ("sc:Integer", "Number of the person."),
    "part": ("sc:Text", "training, validation or test."),
}


def croissant(frozen: FrozenSet, files: Mapping[str, tuple[str, int]], columns: Sequence[str]) -> dict[str, Any]:
    """The description, JSON-ready.

    files    CSV file of the folder -> its sha256 and its size in bytes; manifest.csv and splits.csv among them
    columns  of manifest.csv
    """
    known = {name: what for name, what in _RADIOGRAPH.items() if name in columns}
    return {
        "@context": _context(),
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
        "distribution": [*(_file(name, *about) for name, about in files.items()), _images()],
        "recordSet": [
            _table("radiographs", "manifest.csv", known, "One record a radiograph.", [_name_of_image()]),
            _table("splits", "splits.csv", _SPLIT, "Fixed splits by person; both knees of a person are in one part."),
            _parts(),
            _pictures(),
        ],
    }


def _file(name: str, sha256: str, size: int) -> dict[str, Any]:
    about = {"contentUrl": name, "contentSize": f"{size} B", "encodingFormat": "text/csv", "sha256": sha256}
    return {"@type": "cr:FileObject", "@id": name, "name": name, **about}


def _images() -> dict[str, Any]:
    what = "16-bit TIFF, linear signal, row 0 proximal; hashes are in manifest.csv."
    where = {"encodingFormat": "image/tiff", "includes": "images/*.tif"}
    return {"@type": "cr:FileSet", "@id": "images", "name": "images", "description": what, **where}


def _table(
    name: str,
    file: str,
    columns: Mapping[str, tuple[str, str]],
    description: str,
    more: Sequence[dict[str, Any]] = (),
) -> dict[str, Any]:
    fields = []
    for column, (kind, what) in columns.items():
        source = {"fileObject": {"@id": file}, "extract": {"column": column}}
        fields.append(_field(f"{name}/{column}", kind, what, source))
        if column == "part":
            fields[-1]["references"] = {"field": {"@id": "parts/name"}}
    held = {"@type": "cr:RecordSet", "@id": name, "name": name, "description": description}
    return (
        held | ({"key": {"@id": f"{name}/radiograph"}} if "radiograph" in columns else {}) | {"field": [*fields, *more]}
    )


def _field(identity: str, kind: str, description: str, source: dict[str, Any] | None = None) -> dict[str, Any]:
    about = {"@type": "cr:Field", "@id": identity, "name": identity, "description": description, "dataType": kind}
    return about if source is None else about | {"source": source}


def _name_of_image() -> dict[str, Any]:
    source = {
        "fileObject": {"@id": "manifest.csv"},
        "extract": {"column": "file"},
        "transform": {"regex": "images/(.*)"},
    }
    # No reference to images_by_name, for then a loader reads every image to list the labels.
    return _field("radiographs/image", "sc:Text", "File of the image, by which images_by_name knows it.", source)


def _pictures() -> dict[str, Any]:
    """Every image under the name of its file."""
    said = {"name": "images_by_name", "description": "Every image, by the name of its file."}
    of_name, of_content = (
        {"fileSet": {"@id": "images"}, "extract": {"fileProperty": what}} for what in ("filename", "content")
    )
    fields = [
        _field("images_by_name/name", "sc:Text", "Name of the file.", of_name),
        _field("images_by_name/content", "sc:ImageObject", "The radiograph.", of_content),
    ]
    key = {"@id": "images_by_name/name"}
    return {"@type": "cr:RecordSet", "@id": "images_by_name", **said, "key": key, "field": fields}


def _parts() -> dict[str, Any]:
    """What the parts of a split are called, and mean."""
    fields = [
        _field("parts/name", "sc:Text", "Name of the part."),
        _field("parts/url", "sc:URL", "What it is for."),
    ]
    data = [{"parts/name": name, "parts/url": url} for name, url in _SPLITS.items()]
    said = {"name": "parts", "description": "Parts of a split.", "dataType": "cr:Split", "key": {"@id": "parts/name"}}
    return {"@type": "cr:RecordSet", "@id": "parts", **said, "field": fields, "data": data}


def _context() -> dict[str, Any]:
    """The JSON-LD context that the specification recommends (its appendix 1)."""
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
