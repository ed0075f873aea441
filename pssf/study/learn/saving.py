"""Fitted models as bytes without pickle (skops); the same model gives the same bytes."""

import io
import re
import zipfile
from typing import Any

import pandas as pd
from sklearn.impute import SimpleImputer
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler

# Beside what skops trusts by itself; nothing else is loaded.
_TRUSTED = ["numpy.dtype", "sklearn.tree._tree.Tree", "xgboost.core.Booster", "xgboost.sklearn.XGBClassifier"]
_MOST_BYTES = 2**30
_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest that a ZIP file can say


def portable(fitted: Pipeline) -> Pipeline:
    """A `models.Fitted` pipeline as steps of scikit-learn alone: impute, scale, model, on the features that it kept.

    Its input is a table of the features in `feature_names_in_`; whoever loads it needs no code of this package.
    """
    kept = fitted.named_steps["select"].kept_
    drop, scale = fitted.named_steps["drop"], fitted.named_steps["scale"]
    places = [drop.kept_.index(name) for name in kept]
    # Fitted on one row, a step has the right form; then it is given what was learnt.
    row = pd.DataFrame([drop.median_[kept].to_numpy()], columns=kept)
    impute, scaler = SimpleImputer(strategy="median").fit(row), StandardScaler().fit(row.to_numpy())
    for name in ("mean_", "var_", "scale_"):
        setattr(scaler, name, getattr(scale, name)[places])
    scaler.n_samples_seen_ = scale.n_samples_seen_
    return Pipeline([("impute", impute), ("scale", scaler), ("model", fitted.named_steps["model"])])


def dumps(fitted: Pipeline) -> bytes:
    """The `portable` form as a skops file."""
    import skops.io  # it lists all that it trusts, which takes a second or two, and most commands save nothing

    return _same_bytes(skops.io.dumps(portable(fitted)))


def loads(content: bytes) -> Any:
    """The pipeline of `dumps`; types that such a pipeline does not hold are refused by skops."""
    import skops.io

    return skops.io.loads(content, trusted=_TRUSTED)


def _same_bytes(content: bytes) -> bytes:
    """The same file with objects and parts numbered in order, where skops has addresses and chance, and no time."""
    files = unzipped(content)
    schema = files.pop("schema.json").decode()
    for pattern in (r'(?<="__id__": )\d+', r'(?<="file": ")[^".]+'):
        numbers: dict[str, str] = {}
        for given in re.findall(pattern, schema):
            numbers.setdefault(given, str(len(numbers)))
        schema = re.sub(pattern, lambda hit, to=numbers: to[hit[0]], schema)
    renamed = {f"{numbers[name.split('.')[0]]}.{name.split('.')[1]}": data for name, data in files.items()}
    return zipped({**{name: renamed[name] for name in sorted(renamed)}, "schema.json": schema.encode()})


def zipped(files: dict[str, bytes]) -> bytes:
    """A ZIP file of these, in their order and without a time; skops reads its own and leaves others alone."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as made:
        for name, content in files.items():
            made.writestr(zipfile.ZipInfo(name, _DATE), content, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def unzipped(content: bytes) -> dict[str, bytes]:
    """The files of a ZIP file; raises zipfile.BadZipFile for another, ValueError for one that holds too much."""
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        size = sum(part.file_size for part in packed.infolist())
        if size > _MOST_BYTES:
            raise ValueError(f"content = {size} bytes; allowed: up to {_MOST_BYTES}")
        return {name: packed.read(name) for name in packed.namelist()}
