"""A model as one file: a skops file that anybody's skops loads, with a card and the templates beside its parts.

The card says all that a film is read by: how regions are found and measured, what the classes are called, what the
model has learnt from, and by which code.
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

from ...core.checks import Array, InputError
from ...data.code import code_digest, differing
from ...data.records import Record
from ...radiomics.backends import BACKENDS, backend_for
from ...radiomics.patches import Template
from ..libraries import XGBOOST
from .refit import Kept
from .saving import dumps, loads, unzipped, zipped

SUFFIX = ".skops"
_FORMAT = "pssf model 1"
_CARD = "pssf/model.json"
# What the probabilities of a film depend on.
_CODE = ("core", "data", "detector", "io", "radiomics", "study")
_LIBRARIES = ("pssf", "numpy", "scikit-image", "scikit-learn", "scipy", "skops", XGBOOST)


class TrainedOn(Record, frozen=True):
    """A protocol that a model has learnt from: pitch of its detector, and its distances."""

    protocol: str
    pixel_mm: float
    sdd_mm: float
    sod_mm: float


class Place(Record, frozen=True):
    """A template but for its pixels; see `radiomics.patches.Template`."""

    shape: tuple[int, int]
    row: float
    col: float
    pixel_mm: float
    plateau_mm: float | None
    severe: bool = False


class Made(Record, frozen=True):
    """What made a model: versions of libraries, hashes of the package's parts."""

    versions: dict[str, str]
    code: dict[str, str]


class Card(Record, frozen=True):
    """What a model file says of its model.

    reads       linear: it has learnt from linear pixels; display: from radiographs as displayed, under one tone
    grades      in the order of the classes, and grade_names likewise
    features    that it reads, in its order
    parameters  of the classifier
    backend     that has measured the features; before there was a choice it was pyradiomics
    pixel_mm    pitch that regions are measured at, region_px their side at it
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
    trained_on: tuple[TrainedOn, ...]
    subjects: int
    radiographs: int
    seed: int
    templates: tuple[Place, ...]
    made_by: Made
    backend: str = "pyradiomics"


@dataclass(frozen=True, kw_only=True, eq=False)
class SavedModel:
    """A model of a file, and what it needs to read films."""

    card: Card
    pipeline: Pipeline
    templates: tuple[Template, ...]

    def probabilities(self, features: pd.DataFrame) -> Array:
        """(rows, classes) of the card's grades, from a table with the card's features"""
        return np.asarray(self.pipeline.predict_proba(features[list(self.card.features)]), np.float64)


def made_here(backend: str) -> Made:
    """Versions and code of this process, with those of what measures features."""
    libraries = sorted({*_LIBRARIES, *BACKENDS[backend].libraries})
    return Made(versions={name: version(name) for name in libraries}, code=dict(code_digest(_CODE)))


def pack(kept: Kept, templates: Sequence[Template], **said: Any) -> bytes:
    """A model as a file; the same model and code give the same bytes.

    templates  of `radiomics.compact`
    said       the entries of `Card` that are not of the model itself: reads, grade_names, families, backend, bins,
               pixel_mm, region_px, trained_on, seed
    """
    card = Card(
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
        templates=tuple(_place(template) for template in templates),
        made_by=made_here(said["backend"]),
        **said,
    )
    text = json.dumps(msgspec.to_builtins(card), indent=1).encode()
    with ThreadPoolExecutor() as pool:  # LZMA lets go of the lock
        packed = list(pool.map(_packed, [template.pixels.astype(np.float32).tobytes() for template in templates]))
    pixels = {_pixels(at): content for at, content in enumerate(packed)}
    return zipped({**unzipped(dumps(kept.fitted.pipeline)), _CARD: text, **pixels})


def unpack(content: bytes, name: str) -> SavedModel:
    """The model of a file.

    name    how the file is called in a refusal
    raises  InputError for a file that is none of `pack`, or of another format
    """
    allowed = f"allowed: a model that a study of pssf has saved ({SUFFIX})"
    try:
        files = unzipped(content)
        card = msgspec.json.decode(files[_CARD], type=Card)
        if card.format != _FORMAT:
            raise InputError(f"{name}: format = {card.format!r}; allowed: {_FORMAT!r}, of this version of pssf")
        templates = tuple(_template(place, files[_pixels(at)]) for at, place in enumerate(card.templates))
        pipeline = loads(content)
        _require_reads(pipeline, card, name)
        return SavedModel(card=card, pipeline=pipeline, templates=templates)
    except InputError:
        raise
    except Exception as error:  # a damaged file can fail anywhere in the readers of ZIP, LZMA and skops
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise InputError(f"{name}: no model, or damaged ({reason}); {allowed}") from None


def _require_reads(pipeline: Any, card: Card, name: str) -> None:
    """Refuse a pipeline that is not what the card says."""
    if not isinstance(pipeline, Pipeline):
        raise InputError(f"{name}: holds = {type(pipeline).__name__}; allowed: a Pipeline, as its card says")
    classes, features = len(pipeline.classes_), list(getattr(pipeline[0], "feature_names_in_", ()))
    if classes != len(card.grades) or not set(features) <= set(card.features):
        raise InputError(f"{name}: classes = {classes}, features = {len(features)}; allowed: those of its card")


def backend_here(card: Card) -> str:
    """What measures the features of a model here: what measured them when it was made, or another that can.

    raises  InputError where none can
    """
    return backend_for(card.backend, card.features, f"model {card.name}")


def differences(card: Card) -> str:
    """What a model was made by that is not what is here: versions, and parts of the code; "" where nothing is.

    raises  InputError as `backend_here`
    """
    here = made_here(backend_here(card))
    was, now = card.made_by.versions, here.versions
    versions = [
        f"{name} {was.get(name, 'none')}, here {now.get(name, 'none')}"
        for name in sorted({*was, *now})
        if was.get(name) != now.get(name)
    ]
    code = differing(card.made_by.code, here.code)
    return "; ".join([*versions, *([f"other code of pssf ({code})"] if code else [])])


def _place(template: Template) -> Place:
    rows, cols = template.pixels.shape
    place = {name: float(getattr(template, name)) for name in ("row", "col", "pixel_mm")}
    plateau_mm = None if template.plateau_mm is None else float(template.plateau_mm)
    return Place(shape=(rows, cols), plateau_mm=plateau_mm, severe=template.severe, **place)


def _template(place: Place, packed: bytes) -> Template:
    pixels = np.frombuffer(lzma.decompress(packed), np.float32).reshape(place.shape)
    known = {name: getattr(place, name) for name in ("row", "col", "pixel_mm", "plateau_mm", "severe")}
    return Template(pixels=pixels, **known)


def _pixels(at: int) -> str:
    return f"pssf/template_{at}.xz"


@lru_cache(maxsize=16)
def _packed(pixels: bytes) -> bytes:
    # Half the size that ZIP's own compression gives.
    return lzma.compress(pixels)
