"""Conversion of fitted models to bytes with skops, without pickle; identical models yield identical bytes."""

import io
import re
import zipfile
from typing import Any

import pandas as pd
from sklearn.impute import SimpleImputer
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

# Types that may be loaded in addition to the types that skops trusts by default.
_TRUSTED_TYPES = ["numpy.dtype", "sklearn.tree._tree.Tree", "xgboost.core.Booster", "xgboost.sklearn.XGBClassifier"]
# Maximum unpacked size of a model file, in bytes.
_MAX_BYTES = 2**30
# Earliest date that a ZIP file can store; a fixed date makes the bytes reproducible.
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)


def build_portable_pipeline(fitted: Pipeline) -> Pipeline:
    """Convert a fitted pipeline to scikit-learn steps (impute, scale, model) on the selected features.

    The converted pipeline can be loaded without this package. Its input is a table with the columns in
    ``feature_names_in_``.

    Parameters
    ----------
    fitted : Pipeline
        Pipeline from `classifiers.FittedModel`.

    Returns
    -------
    Pipeline
        Equivalent pipeline for the selected features.
    """
    kept = fitted.named_steps["select"].kept_
    drop, scale = fitted.named_steps["drop"], fitted.named_steps["scale"]
    places = [drop.kept_.index(name) for name in kept]
    # A fit to one row initialises each step; the values of the fitted pipeline are then copied.
    row = pd.DataFrame([drop.median_[kept].to_numpy()], columns=kept)
    impute, scaler = SimpleImputer(strategy="median").fit(row), StandardScaler().fit(row.to_numpy())
    for name in ("mean_", "var_", "scale_"):
        setattr(scaler, name, getattr(scale, name)[places])
    scaler.n_samples_seen_ = scale.n_samples_seen_
    return Pipeline([("impute", impute), ("scale", scaler), ("model", fitted.named_steps["model"])])


def dumps(fitted: Pipeline) -> bytes:
    """Convert a fitted pipeline to a portable pipeline and then to a skops file.

    Parameters
    ----------
    fitted : Pipeline
        Pipeline from `classifiers.FittedModel`.

    Returns
    -------
    bytes
        Content of the skops file.
    """
    import skops.io  # The import is deferred, because it takes one or two seconds and most commands save no model.

    return _normalise_archive(skops.io.dumps(build_portable_pipeline(fitted)))


def loads(content: bytes) -> Any:
    """Load the pipeline from a skops file.

    Parameters
    ----------
    content : bytes
        Content of a file written by `dumps`.

    Returns
    -------
    Pipeline
        Loaded pipeline. skops raises an error if the file contains untrusted types.
    """
    import skops.io

    return skops.io.loads(content, trusted=_TRUSTED_TYPES)


def _normalise_archive(content: bytes) -> bytes:
    """Replace random identifiers in a skops file with consecutive numbers, and set fixed time stamps.

    skops identifies objects by memory addresses and files by random names.
    """
    files = unzip_files(content)
    schema = files.pop("schema.json").decode()
    for pattern in (r'(?<="__id__": )\d+', r'(?<="file": ")[^".]+'):
        numbers: dict[str, str] = {}
        for given in re.findall(pattern, schema):
            numbers.setdefault(given, str(len(numbers)))
        schema = re.sub(pattern, lambda hit, to=numbers: to[hit[0]], schema)
    renamed = {f"{numbers[name.split('.')[0]]}.{name.split('.')[1]}": data for name, data in files.items()}
    return zip_files({**{name: renamed[name] for name in sorted(renamed)}, "schema.json": schema.encode()})


def zip_files(files: dict[str, bytes]) -> bytes:
    """Pack files in a ZIP archive in the specified order, with a fixed time stamp.

    Parameters
    ----------
    files : dict of str to bytes
        Content of each file, keyed by file name. skops ignores unknown files.

    Returns
    -------
    bytes
        Content of the archive.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as made:
        for name, content in files.items():
            made.writestr(zipfile.ZipInfo(name, _ZIP_DATE), content, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def unzip_files(content: bytes) -> dict[str, bytes]:
    """Unpack the files of a ZIP archive.

    Parameters
    ----------
    content : bytes
        Content of the archive.

    Returns
    -------
    dict of str to bytes
        Content of each file, keyed by file name.

    Raises
    ------
    zipfile.BadZipFile
        The content is not a ZIP archive.
    ValueError
        The unpacked files are larger than 1 GiB.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        size = sum(part.file_size for part in packed.infolist())
        if size > _MAX_BYTES:
            raise ValueError(f"unpacked content must have at most {_MAX_BYTES} bytes, got {size}")
        return {name: packed.read(name) for name in packed.namelist()}
