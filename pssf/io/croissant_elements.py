"""Elements of Croissant 1.0 metadata, a JSON-LD format of MLCommons (mlcommons.org/croissant/1.0)."""

from collections.abc import Mapping
from typing import Any

# Standard to which the metadata conforms.
CONFORMS_TO = "http://mlcommons.org/croissant/1.0"
# Identifier in the Croissant vocabulary for each subset of a split.
SPLIT_URLS = {"training": "cr:TrainingSplit", "validation": "cr:ValidationSplit", "test": "cr:TestSplit"}


def build_context() -> dict[str, Any]:
    """Build the JSON-LD context that appendix 1 of the Croissant specification recommends.

    Returns
    -------
    dict of str to object
        Value of ``@context``.
    """
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


def describe_file(name: str, sha256: str, size: int) -> dict[str, Any]:
    """Describe one CSV file.

    Parameters
    ----------
    name : str
        Path of the file, relative to the folder of the data set.
    sha256 : str
        SHA-256 hash of the file.
    size : int
        Size of the file, in bytes.

    Returns
    -------
    dict of str to object
        File object.
    """
    about = {"contentUrl": name, "contentSize": f"{size} B", "encodingFormat": "text/csv", "sha256": sha256}
    return {"@type": "cr:FileObject", "@id": name, "name": name, **about}


def describe_file_set(name: str, encoding: str, includes: str, description: str) -> dict[str, Any]:
    """Describe a set of files.

    Parameters
    ----------
    name : str
        Identifier of the set.
    encoding : str
        Media type of the files.
    includes : str
        Pattern of their paths.
    description : str
        Content of the files.

    Returns
    -------
    dict of str to object
        File set.
    """
    where = {"encodingFormat": encoding, "includes": includes}
    return {"@type": "cr:FileSet", "@id": name, "name": name, "description": description, **where}


def describe_field(identity: str, kind: str, description: str, source: dict[str, Any] | None = None) -> dict[str, Any]:
    """Describe one field of a record set.

    Parameters
    ----------
    identity : str
        Identifier: name of the record set, slash, name of the field.
    kind : str
        Data type, such as "sc:Text".
    description : str
        Meaning of the field.
    source : dict of str to object, optional
        Origin of its values; None: the record set contains them.

    Returns
    -------
    dict of str to object
        Field.
    """
    about = {"@type": "cr:Field", "@id": identity, "name": identity, "description": description, "dataType": kind}
    return about if source is None else about | {"source": source}


def describe_column(table: str, file: str, column: str, kind: str, description: str) -> dict[str, Any]:
    """Describe a field whose values are a column of a CSV file.

    Parameters
    ----------
    table : str
        Name of the record set.
    file : str
        Name of the CSV file.
    column : str
        Name of the column, also of the field.
    kind : str
        Data type, such as "sc:Text".
    description : str
        Meaning of the column.

    Returns
    -------
    dict of str to object
        Field.
    """
    source = {"fileObject": {"@id": file}, "extract": {"column": column}}
    return describe_field(f"{table}/{column}", kind, description, source)


def describe_split_parts(urls: Mapping[str, str]) -> dict[str, Any]:
    """Describe the subsets of a split.

    Parameters
    ----------
    urls : mapping of str to str
        Identifier in the Croissant vocabulary of each subset.

    Returns
    -------
    dict of str to object
        Record set ``parts``.
    """
    fields = [
        describe_field("parts/name", "sc:Text", "Name of the subset."),
        describe_field("parts/url", "sc:URL", "Purpose of the subset, as an identifier of the Croissant vocabulary."),
    ]
    data = [{"parts/name": name, "parts/url": url} for name, url in urls.items()]
    return {
        "@type": "cr:RecordSet",
        "@id": "parts",
        "name": "parts",
        "description": "Subsets of a split.",
        "dataType": "cr:Split",
        "key": {"@id": "parts/name"},
        "field": fields,
        "data": data,
    }


def describe_images(file_set: str, description: str) -> dict[str, Any]:
    """Describe the record set of all images of a file set, keyed by file name.

    Parameters
    ----------
    file_set : str
        Identifier of the file set.
    description : str
        Content of an image.

    Returns
    -------
    dict of str to object
        Record set ``FILE_SET_by_name``.
    """
    name = f"{file_set}_by_name"
    of_name, of_content = (
        {"fileSet": {"@id": file_set}, "extract": {"fileProperty": what}} for what in ("filename", "content")
    )
    fields = [
        describe_field(f"{name}/name", "sc:Text", "File name of the image.", of_name),
        describe_field(f"{name}/content", "sc:ImageObject", description, of_content),
    ]
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": "All images, keyed by file name.",
        "key": {"@id": f"{name}/name"},
        "field": fields,
    }
