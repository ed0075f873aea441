"""Plan a data set part by part, so that a plan of millions of images is never held in memory."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any

import numpy as np

from ..data.knees.oarsi_table import OarsiThresholds
from ..model.kellgren_lawrence import MAX_GRADE, allowed_grades, derive_grade
from ..model.knee import MARGIN_AND_SPINE_SITES, Knee, Osteophyte
from ..model.progression import progress, true_change
from ..model.protocol import Protocol
from ..model.sampling.acquisition import sample_acquisition
from ..model.sampling.knee_sampling import sample_knee_from_distributions, sample_shared_fields
from .dataset_settings import SPLITS, DatasetSettings
from .dataset_tables import DatasetTables

# The following keys separate the random streams of a data set. A stream is identified by the key and a number.
_GRADES, _BODY, _KNEE, _ACQUISITION, _NOISE, _PAIR, _ATTEMPT, _EQUIPMENT, _APPEARANCE = range(9)
# Number of subjects of a part if images are written as single files.
_SUBJECTS_PER_PART = 4
# Time between the two visits of a pair, in years.
_VISIT_RANGE_YEARS = (1.0, 8.0)
# Size of an osteophyte that distinguishes the two knees of a pair, in mm.
_ADDED_OSTEOPHYTE_MM = (2.0, 6.0)


@dataclass(frozen=True, kw_only=True)
class PlannedImage:
    """Parameters of one image of a data set.

    Attributes
    ----------
    name : str
        Name of the image, 16 hexadecimal digits that do not depend on its content.
    subject : str
        Name of the subject, 16 hexadecimal digits.
    split : {"train", "validation", "test"}
        Subset to which all images of the subject belong.
    knee : Knee
        Parameters of the knee.
    protocol : Protocol
        Protocol of the acquisition.
    seed : int
        Seed of the noise.
    appearance_seed : int
        Seed of crop, display processing and randomisation.
    pair : str
        Name that the two images of a pair share; empty if the data set has no pairs.
    role : {"", "first", "second"}
        Position of the image in its pair.
    change : mapping of str to object
        Difference between the two images of a pair: values at the second visit minus the first, the changed lesion, or
        both protocol names.
    """

    name: str
    subject: str
    split: str
    knee: Knee
    protocol: Protocol
    seed: int
    appearance_seed: int
    pair: str = ""
    role: str = ""
    change: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Part:
    """Range of subjects whose images are made together.

    Attributes
    ----------
    index : int
        Index of the part in the data set.
    split : str
        Subset to which the subjects belong.
    split_index : int
        Index of the part in its subset.
    first : int
        Number of the first subject.
    count : int
        Number of subjects.
    """

    index: int
    split: str
    split_index: int
    first: int
    count: int


def count_parts(settings: DatasetSettings) -> int:
    """Count the parts of a data set.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.

    Returns
    -------
    int
        Number of parts.
    """
    size = _count_subjects_per_part(settings)
    return sum(-(-count // size) for _, count in _assign_subjects(settings).values())


def find_part(settings: DatasetSettings, index: int) -> Part:
    """Find the subjects of a part. No part contains subjects of two subsets.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.
    index : int
        Index of the part, from 0.

    Returns
    -------
    Part
        Subset and subjects of the part.

    Raises
    ------
    IndexError
        If the data set has fewer parts.
    """
    size, before = _count_subjects_per_part(settings), 0
    for split, (first, count) in _assign_subjects(settings).items():
        parts = -(-count // size)
        if 0 <= index - before < parts:
            offset = (index - before) * size
            return Part(index, split, index - before, first + offset, min(size, count - offset))
        before += parts
    raise IndexError(f"part must be an index below {before}, got {index}")


def plan_subject(
    settings: DatasetSettings, tables: DatasetTables, subject: int, split: str, *, attempt: int = 0
) -> list[PlannedImage]:
    """Sample the knees of one subject and their acquisitions.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.
    tables : DatasetTables
        Result of `load_dataset_tables`.
    subject : int
        Number of the subject.
    split : str
        Subset to which the subject belongs.
    attempt : int
        Number of earlier plans of this subject whose knees could not be built. The grade is the same in every attempt.

    Returns
    -------
    list of PlannedImage
        Images of the subject.

    Notes
    -----
    For the same settings, the images of a subject do not depend on the number of images, the split or the number of
    workers. Both knees of a subject share the properties of the body (`sample_knee_pair`).
    """
    grade = _sample_grade(settings, tables, subject)
    if attempt:
        settings = replace(settings, seed=int(_stream(settings.seed, attempt, _ATTEMPT).integers(2**63)))
    shared = sample_shared_fields(tables.distributions, grade=grade, rng=_stream(settings.seed, subject, _BODY))
    rng = _stream(settings.seed, subject, _KNEE)
    sides = ("right", "left") if settings.knees_per_subject == 2 else (("right", "left")[int(rng.integers(2))],)
    images = []
    for turn, side in enumerate(sides):
        of_knee = _stream(settings.seed, subject, _KNEE, turn)
        knee = sample_knee_from_distributions(tables.distributions, grade=grade, rng=of_knee, **shared, side=side)
        images += _plan_knee(settings, tables, (subject, turn), split, knee)
    return images


def _plan_knee(
    settings: DatasetSettings, tables: DatasetTables, at: tuple[int, int], split: str, knee: Knee
) -> list[PlannedImage]:
    """Plan the image of a knee, or its pair of images; `at` is the number of the subject and of the knee."""
    chance = _stream(settings.seed, *at, _PAIR)
    nominal = tables.protocols[int(chance.integers(len(tables.protocols)))]
    if settings.pairs == "none":
        return [_plan_image(settings, tables, (*at, 0), split, knee, nominal)]
    first, second, change = (knee, nominal), (knee, nominal), dict[str, Any]()
    if settings.pairs == "protocol":
        first, second = ((knee, protocol) for protocol in tables.protocols)
        change = {"protocol": [first[1].name, second[1].name]}
    elif settings.pairs == "lesion":
        other, change = _change_one_lesion(knee, tables.cuts, chance)
        second = (other, nominal)
    else:
        years = round(float(chance.uniform(*_VISIT_RANGE_YEARS)), 2)
        later = progress(knee, years, int(chance.integers(2**31)))
        second, change = (later, nominal), {"years": years, **true_change(knee, later)}
    pair = _make_name(settings.seed, "pair", *at)
    return [
        replace(_plan_image(settings, tables, (*at, turn), split, *of), pair=pair, role=role, change=change)
        for turn, (role, of) in enumerate((("first", first), ("second", second)))
    ]


def _plan_image(
    settings: DatasetSettings,
    tables: DatasetTables,
    at: tuple[int, int, int],
    split: str,
    knee: Knee,
    nominal: Protocol,
) -> PlannedImage:
    """Sample the acquisition of one image; `at` is the number of the subject, the knee and the image.

    The two images of a lesion pair have the same acquisition, crop, display processing and randomisation. Their knees
    differ in the lesion, and therefore slightly in the pose of the bones for the specified joint space.
    """
    place = (*at[:2], 0 if settings.pairs == "lesion" else at[2])
    if settings.equipment == "sampled":
        nominal = _sample_equipment(nominal, tables, _stream(settings.seed, *place, _EQUIPMENT))
    if settings.acquisition == "sampled":
        nominal = sample_acquisition(nominal, rng=_stream(settings.seed, *place, _ACQUISITION), side=knee.side)
    return PlannedImage(
        name=_make_name(settings.seed, "image", *at),
        subject=_make_name(settings.seed, "subject", at[0]),
        split=split,
        knee=knee,
        protocol=nominal,
        seed=_sample_seed(settings, *at, _NOISE),
        appearance_seed=_sample_seed(settings, *place, _APPEARANCE),
    )


def _sample_equipment(nominal: Protocol, tables: DatasetTables, rng: np.random.Generator) -> Protocol:
    """Sample focal spot, filtration, and the grid of a protocol that has a grid."""
    values = tables.definitions.equipment
    sampled: dict[str, Any] = {name: float(rng.choice(getattr(values, name))) for name in values.__struct_fields__}
    if not nominal.grid_ratio:
        sampled = {name: value for name, value in sampled.items() if not name.startswith("grid_")}
    return replace(nominal, **sampled)


def _change_one_lesion(knee: Knee, cuts: OarsiThresholds, rng: np.random.Generator) -> tuple[Knee, dict[str, Any]]:
    """Remove one osteophyte or cyst of a knee at random, or add an osteophyte to a knee without any."""
    lesions = [("osteophyte", one) for one in knee.osteophytes] + [("cyst", one) for one in knee.cysts]
    if not lesions:
        site, size = (
            MARGIN_AND_SPINE_SITES[int(rng.integers(len(MARGIN_AND_SPINE_SITES)))],
            round(float(rng.uniform(*_ADDED_OSTEOPHYTE_MM)), 2),
        )
        grown = replace(knee, osteophytes=(Osteophyte(site=site, size_mm=size),), grade=None)
        return _regrade(knee, grown, cuts, {"lesion": "osteophyte", "added": True, "site": site, "size_mm": size})
    kind, lost = lesions[int(rng.integers(len(lesions)))]
    kept: dict[str, Any] = {f"{kind}s": tuple(one for one in getattr(knee, f"{kind}s") if one is not lost)}
    size = lost.size_mm if isinstance(lost, Osteophyte) else lost.diameter_mm
    other = replace(knee, **kept, grade=None)
    return _regrade(knee, other, cuts, {"lesion": kind, "added": False, "site": lost.site, "size_mm": size})


def _regrade(knee: Knee, other: Knee, cuts: OarsiThresholds, change: dict[str, Any]) -> tuple[Knee, dict[str, Any]]:
    """Change the grade of a knee with another lesion by the change of its derived grade, as `progress` does.

    A removed lesion never raises the grade, and an added lesion never lowers it.
    """
    if knee.grade is None:
        return other, change
    low, high = allowed_grades(other, cuts)
    stepped = knee.grade + derive_grade(other, cuts) - derive_grade(replace(knee, grade=None), cuts)
    bounded = max(knee.grade, stepped) if change["added"] else min(knee.grade, stepped)
    grade = min(max(bounded, low), high)
    read = None if knee.reader_grade is None else min(max(knee.reader_grade + grade - knee.grade, 0), MAX_GRADE)
    return replace(other, grade=grade, reader_grade=read), {**change, "grade_change": grade - knee.grade}


def _sample_grade(settings: DatasetSettings, tables: DatasetTables, subject: int) -> int:
    """Return the grade of a subject: balanced within blocks of subjects, or sampled with the prevalence."""
    grades = tables.distributions.grades.grades
    if settings.grades == "balanced":
        block, place = divmod(subject, len(grades))
        return int(_stream(settings.seed, block, _GRADES).permutation(grades)[place])
    weights = np.array([tables.definitions.grades.prevalence[grade] for grade in grades])
    return int(_stream(settings.seed, subject, _GRADES).choice(grades, p=weights / weights.sum()))


def _assign_subjects(settings: DatasetSettings) -> dict[str, tuple[int, int]]:
    """Return number of the first subject and number of subjects for each subset."""
    ends = [round(settings.subject_count * total) for total in np.cumsum(settings.split).tolist()[:-1]]
    ends.append(settings.subject_count)
    starts = [0, *ends[:-1]]
    return {split: (start, end - start) for split, start, end in zip(SPLITS, starts, ends, strict=True)}


def _count_subjects_per_part(settings: DatasetSettings) -> int:
    """Count the subjects of a part: those of a shard, or a few subjects if images are single files."""
    if settings.layout == "shards":
        return max(1, settings.shard_images // settings.images_per_subject)
    return _SUBJECTS_PER_PART


def _sample_seed(settings: DatasetSettings, *key: int) -> int:
    """Sample a seed that every reader of JSON represents exactly, because it is below 2**53."""
    return int(_stream(settings.seed, *key).integers(2**53))


def _make_name(seed: int, kind: str, *numbers: int) -> str:
    """Make a name from a hash, so that neither order nor grade can be inferred from it."""
    return blake2b(f"{seed}:{kind}:{numbers}".encode(), digest_size=8).hexdigest()


def _stream(seed: int, *key: int) -> np.random.Generator:
    """Return the random generator with a key."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
