"""Plan a data set part by part, so that a plan of millions of images is never held in memory."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any

import numpy as np

from ..core.random_streams import make_stream
from ..model.knee import Knee
from ..model.progression import progress, true_change
from ..model.protocol import Protocol
from ..model.sampling.acquisition import sample_acquisition
from ..model.sampling.knee_sampling import sample_knee_from_distributions, sample_shared_fields
from .dataset_settings import SPLITS, DatasetSettings
from .dataset_tables import DatasetTables
from .lesion_change import change_one_lesion

# The following keys separate the random streams of a data set. A stream is identified by the key and a number.
_GRADES, _BODY, _KNEE, _ACQUISITION, _NOISE, _PAIR, _ATTEMPT, _EQUIPMENT, _APPEARANCE = range(9)
# Number of subjects of a part if images are written as single files.
_SUBJECTS_PER_PART = 4
# Time between the two visits of a pair, in years.
_VISIT_RANGE_YEARS = (1.0, 8.0)
# Knee of an image, and the other knee of the subject if a protocol images both knees.
_Knees = tuple[Knee, Knee | None]


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
    other : Knee or None
        Other knee of the subject, if the protocol images both knees.
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
    other: Knee | None = None
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
    workers. Both knees of a subject share the properties of the body (`sample_knee_pair`). A protocol that images both
    knees gives one image per knee; the images of both knees have the same acquisition and noise, as parts of one
    radiograph.
    """
    grade = _sample_grade(settings, tables, subject)
    if attempt:
        settings = replace(settings, seed=int(make_stream(settings.seed, attempt, _ATTEMPT).integers(2**63)))
    shared = sample_shared_fields(tables.distributions, grade=grade, rng=make_stream(settings.seed, subject, _BODY))
    rng = make_stream(settings.seed, subject, _KNEE)
    sides = ["right", "left"]
    if settings.knees_per_subject == 1 and rng.integers(2):
        sides.reverse()
    images_both = any(protocol.knee_distance_mm for protocol in tables.protocols)
    knees = [
        sample_knee_from_distributions(
            tables.distributions, grade=grade, rng=make_stream(settings.seed, subject, _KNEE, turn), **shared, side=side
        )
        for turn, side in enumerate(sides if images_both else sides[: settings.knees_per_subject])
    ]
    images = []
    for turn in range(settings.knees_per_subject):
        other = knees[1 - turn] if images_both else None
        images += _plan_knee(settings, tables, (subject, turn), split, (knees[turn], other))
    return images


def _plan_knee(
    settings: DatasetSettings, tables: DatasetTables, at: tuple[int, int], split: str, knees: _Knees
) -> list[PlannedImage]:
    """Plan the image of a knee, or its pair of images; `at` is the number of the subject and of the knee."""
    nominal, chance = _choose_protocol(settings, tables, at)
    if settings.pairs == "none":
        return [_plan_image(settings, tables, (*at, 0), split, knees, nominal)]
    first, second, change = (knees, nominal), (knees, nominal), dict[str, Any]()
    if settings.pairs == "protocol":
        first, second = ((knees, protocol) for protocol in tables.protocols)
        change = {"protocol": [first[1].name, second[1].name]}
    elif settings.pairs == "lesion":
        changed, change = change_one_lesion(knees[0], tables.cuts, chance)
        second = ((changed, knees[1]), nominal)
    else:
        years, (later, other) = _plan_later_visit(settings, tables, at, knees)
        second, change = ((later, other), nominal), {"years": years, **true_change(knees[0], later)}
    pair = _make_name(settings.seed, "pair", *at)
    return [
        replace(_plan_image(settings, tables, (*at, turn), split, *of), pair=pair, role=role, change=change)
        for turn, (role, of) in enumerate((("first", first), ("second", second)))
    ]


def _plan_later_visit(
    settings: DatasetSettings, tables: DatasetTables, at: tuple[int, int], knees: _Knees
) -> tuple[float, _Knees]:
    """Sample the time to the second visit, in years, and the knees at this visit.

    If a radiograph shows both knees, the visit of the first knee is that of the subject.
    """
    subject, turn = at
    visits = {}
    for number in (turn,) if knees[1] is None else (0, 1):
        _, chance = _choose_protocol(settings, tables, (subject, number))
        visits[number] = round(float(chance.uniform(*_VISIT_RANGE_YEARS)), 2), int(chance.integers(2**31))
    years, _ = visits[min(visits)]
    other = None if knees[1] is None else progress(knees[1], years, visits[1 - turn][1])
    return years, (progress(knees[0], years, visits[turn][1]), other)


def _choose_protocol(
    settings: DatasetSettings, tables: DatasetTables, at: tuple[int, int]
) -> tuple[Protocol, np.random.Generator]:
    """Choose the protocol of a knee at random; also return the generator for the difference between its two images."""
    chance = make_stream(settings.seed, *at, _PAIR)
    return tables.protocols[int(chance.integers(len(tables.protocols)))], chance


def _plan_image(
    settings: DatasetSettings,
    tables: DatasetTables,
    at: tuple[int, int, int],
    split: str,
    knees: _Knees,
    nominal: Protocol,
) -> PlannedImage:
    """Sample the acquisition of one image; `at` is the number of the subject, the knee and the image.

    The two images of a lesion pair have the same acquisition, crop, display processing and randomisation. Their knees
    differ in the lesion, and therefore slightly in the pose of the bones for the specified joint space.
    """
    knee, other = knees
    place = (*at[:2], 0 if settings.pairs == "lesion" else at[2])
    # Both knees of a bilateral radiograph have the same acquisition and noise.
    exposed, noise = ((place[0], 0, place[2]), (at[0], 0, at[2])) if nominal.knee_distance_mm else (place, at)
    if settings.equipment == "sampled":
        nominal = _sample_equipment(nominal, tables, make_stream(settings.seed, *exposed, _EQUIPMENT))
    if settings.acquisition == "sampled":
        side = None if nominal.knee_distance_mm else knee.side
        nominal = sample_acquisition(nominal, rng=make_stream(settings.seed, *exposed, _ACQUISITION), side=side)
    return PlannedImage(
        name=_make_name(settings.seed, "image", *at),
        subject=_make_name(settings.seed, "subject", at[0]),
        split=split,
        knee=knee,
        other=other if nominal.knee_distance_mm else None,
        protocol=nominal,
        seed=_sample_seed(settings, *noise, _NOISE),
        appearance_seed=_sample_seed(settings, *place, _APPEARANCE),
    )


def _sample_equipment(nominal: Protocol, tables: DatasetTables, rng: np.random.Generator) -> Protocol:
    """Sample focal spot, filtration, and the grid of a protocol that has a grid."""
    values = tables.definitions.equipment
    sampled: dict[str, Any] = {name: float(rng.choice(getattr(values, name))) for name in values.__struct_fields__}
    if not nominal.grid_ratio:
        sampled = {name: value for name, value in sampled.items() if not name.startswith("grid_")}
    return replace(nominal, **sampled)


def _sample_grade(settings: DatasetSettings, tables: DatasetTables, subject: int) -> int:
    """Return the grade of a subject: balanced within blocks of subjects, or sampled with the prevalence."""
    grades = tables.distributions.grades.grades
    if settings.grades == "balanced":
        block, place = divmod(subject, len(grades))
        return int(make_stream(settings.seed, block, _GRADES).permutation(grades)[place])
    weights = np.array([tables.definitions.grades.prevalence[grade] for grade in grades])
    return int(make_stream(settings.seed, subject, _GRADES).choice(grades, p=weights / weights.sum()))


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
    return int(make_stream(settings.seed, *key).integers(2**53))


def _make_name(seed: int, kind: str, *numbers: int) -> str:
    """Make a name from a hash, so that neither order nor grade can be inferred from it."""
    return blake2b(f"{seed}:{kind}:{numbers}".encode(), digest_size=8).hexdigest()
