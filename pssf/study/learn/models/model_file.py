"""Model files: a skops file that also contains a model card and the templates.

Any skops installation can load the pipeline. The model card describes the localisation of regions, the measurement of
features, the classes, the training data, and the versions of code and libraries.
"""

import json
import lzma
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from typing import Any

import msgspec
import numpy as np
import pandas as pd
from sklearn.pipeline import Pipeline

from ....core.checks import Array, InputError
from ....data.code_hash import compute_code_hashes, format_differing_parts
from ....data.table_records import Record
from ....radiomics.features.feature_backends import BACKENDS, select_backend
from ....radiomics.features.feature_families import SQUARE
from ....radiomics.localisation.templates import Template
from ...libraries import XGBOOST
from .final_models import RefittedModel
from .model_bytes import (
    dumps,
    loads,
    unzip_files,
    zip_files,
)

# File name suffix of model files.
MODEL_SUFFIX = ".skops"
# Version of the file format, as stored in the model card.
_FORMAT = "pssf model 1"
# Name of the model card inside the model file.
_CARD_FILE = "pssf/model.json"
# Subpackages whose code affects the predicted probabilities.
_CODE_PACKAGES = ("core", "data", "detector", "io", "radiomics", "study")
# PyPI packages whose versions are stored in the model card.
_LIBRARIES = ("pssf", "numpy", "scikit-image", "scikit-learn", "scipy", "skops", XGBOOST)


class TrainingProtocol(Record, frozen=True):
    """Protocol of the training radiographs of a model.

    Attributes
    ----------
    protocol : str
        Name of the protocol.
    pixel_mm : float
        Pixel pitch of the detector, in mm.
    sdd_mm : float
        Source-detector distance, in mm.
    sod_mm : float
        Source-object distance, in mm.
    """

    protocol: str
    pixel_mm: float
    sdd_mm: float
    sod_mm: float


class TemplateRecord(Record, frozen=True):
    """Template without its pixels; see `radiomics.localisation.templates.Template`.

    Attributes
    ----------
    shape : tuple of int
        Number of pixel rows and columns.
    row : float
        Row of the medial joint line, in px.
    col : float
        Column of the medial joint line, in px.
    pixel_mm : float
        Pixel pitch of the detector, in mm.
    plateau_mm : float or None
        Width of the tibial plateau at the detector, in mm; None if unknown.
    severe : bool
        True for a template of a knee with severe OA, which is used only if no other template matches well.
    """

    shape: tuple[int, int]
    row: float
    col: float
    pixel_mm: float
    plateau_mm: float | None
    severe: bool = False


class SoftwareVersions(Record, frozen=True):
    """Software that was used to make a model.

    Attributes
    ----------
    versions : dict of str to str
        Version of each library, keyed by library name.
    code : dict of str to str
        Hash of the code in each subpackage, keyed by subpackage.
    """

    versions: dict[str, str]
    code: dict[str, str]


class ModelCard(Record, frozen=True):
    """Model card: description of a model, stored in the model file.

    Attributes
    ----------
    format : str
        Version of the file format.
    name : str
        Name of the model.
    reads : str
        Pixel values of the training radiographs: "linear" (in the signal) or "display" (processed for display).
    task : str
        Name of the classification task.
    grades : tuple of int
        Lowest grade of each class, in order of the classes.
    grade_names : tuple of str
        Name of each class, in the order of `grades`.
    model : str
        Name of the classifier.
    selection : str
        Name of the feature selection.
    parameters : dict of str to float
        Hyperparameters of the classifier.
    features : tuple of str
        Names of the model features, in column order.
    families : tuple of str
        Feature families to measure.
    bins : int
        Number of grey-level bins of the texture features.
    pixel_mm : float
        Pixel pitch at which regions are measured, in mm.
    region_px : int
        Side length of the region at the pixel pitch `pixel_mm`, in px.
    trained_on : tuple of TrainingProtocol
        Protocols of the training radiographs.
    subjects : int
        Number of training subjects.
    radiographs : int
        Number of training radiographs.
    seed : int
        Seed of the study.
    templates : tuple of TemplateRecord
        Templates without pixels.
    made_by : SoftwareVersions
        Software that was used to make the model.
    backend : str
        Radiomics backend that measured the features. Older files have no backend field and used pyradiomics.
    regions : {"template", "reader"}
        Source of the position of the regions. Older files have no regions field and used templates.
    areas : tuple of str
        Measured areas. Older files have no areas field and used the square.
    """

    format: str
    name: str
    reads: str
    task: str
    grades: tuple[int, ...]
    grade_names: tuple[str, ...]
    model: str
    selection: str
    parameters: dict[str, float]
    features: tuple[str, ...]
    families: tuple[str, ...]
    bins: int
    pixel_mm: float
    region_px: int
    trained_on: tuple[TrainingProtocol, ...]
    subjects: int
    radiographs: int
    seed: int
    templates: tuple[TemplateRecord, ...]
    made_by: SoftwareVersions
    backend: str = "pyradiomics"
    regions: str = "template"
    areas: tuple[str, ...] = (SQUARE,)


@dataclass(frozen=True, kw_only=True, eq=False)
class SavedModel:
    """Model loaded from a model file.

    Attributes
    ----------
    card : ModelCard
        Description of the model.
    pipeline : Pipeline
        Fitted pipeline that predicts class probabilities from features.
    templates : tuple of Template
        Templates for joint localisation.
    """

    card: ModelCard
    pipeline: Pipeline
    templates: tuple[Template, ...]

    def predict_probabilities(self, features: pd.DataFrame) -> Array:
        """Predict the class probabilities of radiographs from their features.

        Parameters
        ----------
        features : DataFrame
            One row per radiograph, with the features listed in the model card.

        Returns
        -------
        (rows, classes) float64 array
            Probability of each class in the model card.
        """
        return np.asarray(self.pipeline.predict_proba(features[list(self.card.features)]), np.float64)


def collect_software_versions(backend: str) -> SoftwareVersions:
    """Collect the library versions and code hashes of this process.

    Parameters
    ----------
    backend : str
        Radiomics backend; the versions of its libraries are included.

    Returns
    -------
    SoftwareVersions
        Library versions and code hashes.
    """
    libraries = sorted({*_LIBRARIES, *BACKENDS[backend].libraries})
    return SoftwareVersions(
        versions={name: version(name) for name in libraries}, code=dict(compute_code_hashes(_CODE_PACKAGES))
    )


def pack_model(kept: RefittedModel, templates: Sequence[Template], **card_entries: Any) -> bytes:
    """Pack a model, its card and the templates as one file; identical models and code yield identical bytes.

    Parameters
    ----------
    kept : RefittedModel
        Model to pack.
    templates : sequence of Template
        Templates cropped by `radiomics.localisation.crop_template`.
    **card_entries : Any
        Fields of `ModelCard` that `kept` does not contain: reads, grade_names, families, backend, regions, areas, bins,
        pixel_mm, region_px, trained_on, seed.

    Returns
    -------
    bytes
        Content of the model file.
    """
    card = ModelCard(
        format=_FORMAT,
        name=kept.name,
        task=kept.task,
        grades=kept.grades,
        model=kept.model,
        selection=kept.selection,
        parameters=kept.fitted.parameters,
        features=kept.features,
        subjects=kept.subjects,
        radiographs=kept.radiographs,
        templates=tuple(_make_template_record(template) for template in templates),
        made_by=collect_software_versions(card_entries["backend"]),
        **card_entries,
    )
    text = json.dumps(msgspec.to_builtins(card), indent=1).encode()
    with ThreadPoolExecutor() as pool:  # Threads run in parallel, because LZMA releases the global interpreter lock.
        packed = list(
            pool.map(_compress_pixels, [template.pixels.astype(np.float32).tobytes() for template in templates])
        )
    pixels = {_template_file_name(at): content for at, content in enumerate(packed)}
    return zip_files({**unzip_files(dumps(kept.fitted.pipeline)), _CARD_FILE: text, **pixels})


def unpack_model(content: bytes, name: str) -> SavedModel:
    """Unpack a model file.

    Parameters
    ----------
    content : bytes
        Content of the model file.
    name : str
        File name in error messages.

    Returns
    -------
    SavedModel
        Card, pipeline and templates.

    Raises
    ------
    InputError
        The file is damaged, is not a pssf model, or has another format version.
    """
    allowed = f"a model saved by pssf study ({MODEL_SUFFIX})"
    try:
        files = unzip_files(content)
        card = msgspec.json.decode(files[_CARD_FILE], type=ModelCard)
        if card.format != _FORMAT:
            raise InputError(
                f"{name}: format must be {_FORMAT!r}, got {card.format!r}: another version of pssf wrote the file"
            )
        templates = tuple(
            _load_template(place, files[_template_file_name(at)]) for at, place in enumerate(card.templates)
        )
        pipeline = loads(content)
        _require_matching_card(pipeline, card, name)
        return SavedModel(card=card, pipeline=pipeline, templates=templates)
    except InputError:
        raise
    except Exception as error:  # A damaged file causes many types of errors in ZIP, LZMA and skops.
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise InputError(
            f"{name}: content must be {allowed}, got a damaged file or another file type ({reason})"
        ) from None


def _require_matching_card(pipeline: Any, card: ModelCard, name: str) -> None:
    """Raise InputError for a pipeline that does not match its model card."""
    if not isinstance(pipeline, Pipeline):
        raise InputError(f"{name}: content must be a scikit-learn Pipeline, got {type(pipeline).__name__}")
    classes, features = len(pipeline.classes_), list(getattr(pipeline[0], "feature_names_in_", ()))
    if classes != len(card.grades) or not set(features) <= set(card.features):
        raise InputError(
            f"{name}: classes and features must match the model card, got {classes} classes, {len(features)} features"
        )


def resolve_backend(card: ModelCard) -> str:
    """Select the radiomics backend for the features of a model.

    Parameters
    ----------
    card : ModelCard
        Description of the model.

    Returns
    -------
    str
        Backend in the model card if it is installed, otherwise another backend that measures all model features.

    Raises
    ------
    InputError
        No installed backend measures all model features.
    """
    return select_backend(card.backend, card.features, f"model {card.name}")


def describe_version_differences(card: ModelCard) -> str:
    """Describe the differences between this installation and the software that was used to make a model.

    Parameters
    ----------
    card : ModelCard
        Description of the model.

    Returns
    -------
    str
        Libraries with different versions and subpackages with different code; "" if there is no difference.

    Raises
    ------
    InputError
        No installed backend measures all model features.
    """
    here = collect_software_versions(resolve_backend(card))
    was, now = card.made_by.versions, here.versions
    versions = [
        f"{name} {was.get(name, 'none')}, here {now.get(name, 'none')}"
        for name in sorted({*was, *now})
        if was.get(name) != now.get(name)
    ]
    code = format_differing_parts(card.made_by.code, here.code)
    return "; ".join([*versions, *([f"different pssf code ({code})"] if code else [])])


def _make_template_record(template: Template) -> TemplateRecord:
    """Make a record of all template fields except the pixels."""
    rows, cols = template.pixels.shape
    place = {name: float(getattr(template, name)) for name in ("row", "col", "pixel_mm")}
    plateau_mm = None if template.plateau_mm is None else float(template.plateau_mm)
    return TemplateRecord(shape=(rows, cols), plateau_mm=plateau_mm, severe=template.severe, **place)


def _load_template(place: TemplateRecord, packed: bytes) -> Template:
    """Build a template from its record and its compressed pixels."""
    pixels = np.frombuffer(lzma.decompress(packed), np.float32).reshape(place.shape)
    known = {name: getattr(place, name) for name in ("row", "col", "pixel_mm", "plateau_mm", "severe")}
    return Template(pixels=pixels, **known)


def _template_file_name(index: int) -> str:
    """Return the file name of a template inside the model file."""
    return f"pssf/template_{index}.xz"


@lru_cache(maxsize=16)
def _compress_pixels(pixels: bytes) -> bytes:
    """Compress pixels with LZMA."""
    # LZMA output is half the size of deflate (ZIP) output.
    return lzma.compress(pixels)
