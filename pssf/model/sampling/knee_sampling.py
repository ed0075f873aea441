"""Sample a knee, or both knees of a person, of a KL grade from a grade table."""

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from ...core.checks import (
    InputError,
    RNGLike,
    build_from_table,
    require_choice,
    resolve_generator,
)
from ...core.keyword_arguments import check_keywords
from ...data.anatomy.limb_table import LimbStatistics, load_limb_statistics
from ...data.anatomy.shape_table import load_shape_model
from ...data.anatomy.trabecular_table import load_trabecular_bone
from ...data.knees.field_definitions import FieldSpec, load_field_specs
from ...data.knees.grade_records import RangeGradeTable, SeverityGradeTable
from ...data.knees.grade_tables import list_tables_with_grade, load_grade_table, resolve_grade_table_name
from ...data.table_records import Pair
from ..knee import (
    MARGIN_AND_SPINE_SITES,
    MAX_SHAPE_SD,
    Knee,
    Osteophyte,
)
from .severity_sampling import sample_severity_fields

# Grade table that is used if none is named.
DEFAULT_GRADE_TABLE = "population"
# Standard scores of normal distributions are limited to this number of standard deviations.
_TRUNCATION_SD = 2.0
# Fields that the two knees of a person share.
_SHARED_FIELDS = (
    "sex", "stature_mm", "bone_scale", "cortex_scale", "bmi", "limb_ap_mm", "fat_mm", "skin_folds", "age_years",
    "bone_density", "shape", "fibular_tip_mm", "insall_salvati", "fabella_mm", "mechanical_axis_deg",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class KneeDistributions:
    """Distributions that knees are sampled from.

    Attributes
    ----------
    table : str
        Name of the grade table, or the file name of a user's own table.
    grades : RangeGradeTable or SeverityGradeTable
        Grade table.
    mode_count : int
        Number of modes of bone shape.
    limbs : LimbStatistics
        BMI, and thickness of limb and fat by BMI and sex.
    bmi : FieldSpec
        Allowed range of the BMI.
    density : (mean, SD) pair of float
        Distribution of `Knee.bone_density`.
    """

    table: str
    grades: RangeGradeTable | SeverityGradeTable
    mode_count: int
    limbs: LimbStatistics
    bmi: FieldSpec
    density: Pair


def load_knee_distributions(table: str) -> KneeDistributions:
    """Load a grade table and the distributions that all tables share.

    Parameters
    ----------
    table : str
        Name of a grade table, or path of a TOML file.

    Returns
    -------
    KneeDistributions
        The distributions.

    Raises
    ------
    InputError
        If the table is unknown or cannot be read.
    """
    grades = load_grade_table(table)
    own = Path(table).suffix == ".toml"
    return KneeDistributions(
        table=Path(table).name if own else resolve_grade_table_name(str(table)),
        grades=grades,
        mode_count=len(load_shape_model().modes),
        limbs=load_limb_statistics(),
        bmi=load_field_specs("knee")["bmi"],
        density=load_trabecular_bone().person.density,
    )


@check_keywords(table="grade_table")
def sample_knee(*, grade: int, rng: RNGLike, grade_table: str = DEFAULT_GRADE_TABLE, **fixed: Any) -> Knee:
    """Sample a knee of a KL grade from a grade table.

    Parameters
    ----------
    grade : int
        KL grade: 0 to 4 in the table ``population``, 0 to 2 in ``paper``.
    rng : int or numpy.random.Generator
        Seed or generator; the only source of randomness. Size and pose are sampled from it. Texture seed, shape and BMI
        are sampled from its child generators.
    grade_table : str, default "population"
        In ``population`` the grades overlap as in patients, and the joint spaces are those that readers measure. In
        ``paper`` the joint space alone separates grades 0 to 2. A path of a TOML file names a user's own table.
    **fixed : object
        Fields of `Knee` to hold at a given value. The other fields do not depend on them, with two exceptions: sizes
        depend on `sex`, and limb thickness and fat depend on `bmi`.

    Returns
    -------
    Knee
        The sampled knee.

    Raises
    ------
    InputError
        If the grade, the table or a field is unknown, a value is not allowed, or `rng` is neither an integer nor a
        Generator.

    Examples
    --------
    >>> import pssf
    >>> knee = pssf.sample_knee(grade=2, rng=7)
    >>> knee.grade, knee.grade_table
    (2, 'population')
    """
    laws = load_knee_distributions(grade_table)
    _require_grade(laws, grade, list_tables_with_grade(grade))
    return sample_knee_from_distributions(laws, grade=grade, rng=resolve_generator(rng), **fixed)


def _require_grade(distributions: KneeDistributions, grade: int, tables_with_grade: Sequence[str] = ()) -> None:
    """Check that the grade table has a grade; the error names the package's tables that have it."""
    whole = isinstance(grade, Integral) and not isinstance(grade, bool)
    if whole and grade in distributions.grades.grades:
        return
    hint = f": grade table {', '.join(tables_with_grade)} has it" if whole and tables_with_grade else ""
    allowed = ", ".join(map(str, distributions.grades.grades))
    raise InputError(f"grade must be one of {allowed} in grade table {distributions.table}, got {grade!r}{hint}")


def sample_knee_from_distributions(
    distributions: KneeDistributions, *, grade: int, rng: np.random.Generator, **fixed: Any
) -> Knee:
    """Sample a knee as `sample_knee` does, from distributions that are already loaded.

    Parameters
    ----------
    distributions : KneeDistributions
        Result of `load_knee_distributions`.
    grade : int
        KL grade.
    rng : numpy.random.Generator
        Generator; the only source of randomness.
    **fixed : object
        Fields of `Knee` to hold at a given value.

    Returns
    -------
    Knee
        The sampled knee.

    Raises
    ------
    InputError
        If the table lacks the grade, or a fixed field is unknown or not allowed.
    """
    law = distributions.grades
    _require_grade(distributions, grade)
    men = 0.5 if isinstance(law, RangeGradeTable) else 1 - law.rest.women[grade]
    sex = fixed.get("sex", "male" if rng.random() < men else "female")
    require_choice("sex", sex, ("male", "female"))
    drawn: dict[str, Any] = {
        "sex": sex,
        "grade": int(grade),
        "grade_table": distributions.table,
        "side": "right" if rng.random() < 0.5 else "left",
    }
    for name, shared in law.body.items():
        drawn[name] = _sample_normal(rng, shared, sex)
    ranges = law.grade[str(int(grade))] if isinstance(law, RangeGradeTable) else None
    if ranges is not None:
        for name in ("jsw_medial_mm", "jsw_lateral_mm", "subchondral_plate", "varus_deg"):
            drawn[name] = _sample_uniform(rng, getattr(ranges, name))
    for name, bounds in law.pose.items():
        drawn[name] = _sample_uniform(rng, bounds)
    # One number serves both seeds, since they seed independent things.
    drawn["texture_seed"] = drawn["form_seed"] = int(rng.spawn(1)[0].integers(2**63))
    # The following uses child generators, so that it does not change the values sampled above.
    drawn |= _sample_bone_form(rng.spawn(1)[0], law, sex, distributions.mode_count)
    if isinstance(law, SeverityGradeTable):
        drawn |= sample_severity_fields(law, int(grade), sex, drawn["bone_scale"], rng.spawn(1)[0])
        # A leg in varus leans more, which keeps its joint line level.
        lean_deg = drawn["lean_deg"] + law.rest.lean_per_varus * drawn["varus_deg"]
        drawn["lean_deg"] = round(float(np.clip(lean_deg, -15.0, 15.0)), 4)
    elif ranges is not None:
        drawn["osteophytes"] = _sample_osteophytes(rng, ranges.osteophyte_count, ranges.largest_osteophyte_mm)
    rest = law.rest if isinstance(law, SeverityGradeTable) else None
    heavier, denser = (rest.bmi_offset[grade], rest.density_offset[grade]) if rest else (0.0, 0.0)
    bmi = fixed.get("bmi", round(_sample_normal(rng.spawn(1)[0], distributions.limbs.bmi, sex) + heavier, 4))
    distributions.bmi.check("bmi", bmi)
    drawn |= _compute_limb_sizes(bmi, sex, drawn, distributions.limbs)
    drawn["bone_density"] = round(_sample_normal(rng.spawn(1)[0], distributions.density, sex) + denser, 4)
    if isinstance(law, SeverityGradeTable):
        drawn |= _sample_skin_folds_and_hip_axis(law, bmi, sex, rng)
    return build_from_table(Knee, {**drawn, **fixed}, "sample_knee")


def _sample_skin_folds_and_hip_axis(
    law: SeverityGradeTable, bmi: float, sex: str, rng: np.random.Generator
) -> dict[str, float]:
    """Sample the depth of skin folds and the mechanical axis of the femur, where the table defines them."""
    sampled = {}
    if law.skin_folds is not None:
        most = np.interp(bmi, *np.array(law.skin_folds.max_depth_by_bmi).T)
        sampled["skin_folds"] = round(float(most) * rng.spawn(1)[0].random(), 4)
    if law.hip is not None:
        angle_deg = _sample_normal(rng.spawn(1)[0], law.hip.mechanical_axis_deg, sex)
        sampled["mechanical_axis_deg"] = float(np.clip(angle_deg, 1.0, 9.0))
    return sampled


def sample_knees(distributions: KneeDistributions, count: int, seed: int, **fixed: Any) -> list[Knee]:
    """Sample knees that cycle through all grades of a table; knee k does not depend on `count`.

    Parameters
    ----------
    distributions : KneeDistributions
        Result of `load_knee_distributions`.
    count : int
        Number of knees.
    seed : int
        Seed; each knee has its own stream below it.
    **fixed : object
        Fields of `Knee` to hold at a given value.

    Returns
    -------
    list of Knee
        The sampled knees.

    Raises
    ------
    InputError
        If a fixed field is unknown or not allowed.
    """
    grades = distributions.grades.grades
    streams = (np.random.SeedSequence(seed, spawn_key=(index,)) for index in range(count))
    return [
        sample_knee_from_distributions(
            distributions, grade=grades[index % len(grades)], rng=np.random.default_rng(stream), **fixed
        )
        for index, stream in enumerate(streams)
    ]


@check_keywords(table="grade_table")
def sample_knee_pair(
    *, grade: int, rng: RNGLike, grade_table: str = DEFAULT_GRADE_TABLE, **fixed: Any
) -> tuple[Knee, Knee]:
    """Sample the right and the left knee of a person, both of one KL grade, with one body.

    Parameters
    ----------
    grade : int
        KL grade of both knees, as in `sample_knee`.
    rng : int or numpy.random.Generator
        Seed or generator; the only source of randomness.
    grade_table : str, default "population"
        Grade table, as in `sample_knee`.
    **fixed : object
        Fields of `Knee` to hold at a given value in both knees, except `side`.

    Returns
    -------
    right : Knee
        Right knee.
    left : Knee
        Left knee.

    Raises
    ------
    InputError
        If the grade, the table or a field is unknown, a value is not allowed, or `rng` is neither an integer nor a
        Generator.

    Notes
    -----
    Both knees share sex, stature, age, BMI, limb and fat thickness, and skin folds. They also share the size, shape,
    cortex and density of the bones, the height of fibula and patella, the fabella and the mechanical axis. Joint
    spaces, alignment, osteophytes and pose are sampled for each knee.

    Examples
    --------
    >>> import pssf
    >>> right, left = pssf.sample_knee_pair(grade=3, rng=7)
    >>> right.side, left.side, right.stature_mm == left.stature_mm
    ('right', 'left', True)
    """
    laws = load_knee_distributions(grade_table)
    _require_grade(laws, grade, list_tables_with_grade(grade))
    of_body, *of_knees = resolve_generator(rng).spawn(3)
    shared = fixed | sample_shared_fields(laws, grade=grade, rng=of_body, **fixed)
    right, left = (
        sample_knee_from_distributions(laws, grade=grade, rng=of_knee, **shared, side=side)
        for of_knee, side in zip(of_knees, ("right", "left"), strict=True)
    )
    return right, left


def sample_shared_fields(
    distributions: KneeDistributions, *, grade: int, rng: np.random.Generator, **fixed: Any
) -> dict[str, Any]:
    """Sample the fields that the two knees of a person share.

    Parameters
    ----------
    distributions : KneeDistributions
        Result of `load_knee_distributions`.
    grade : int
        KL grade of both knees.
    rng : numpy.random.Generator
        Generator of the person's own stream.
    **fixed : object
        Fields of `Knee` to hold at a given value.

    Returns
    -------
    dict of str to object
        Field of `Knee` and value.

    Raises
    ------
    InputError
        If the table lacks the grade, or a fixed field is unknown or not allowed.
    """
    body = sample_knee_from_distributions(distributions, grade=grade, rng=rng, **fixed)
    return {name: getattr(body, name) for name in _SHARED_FIELDS}


def _compute_limb_sizes(bmi: float, sex: str, sampled: dict[str, Any], law: LimbStatistics) -> dict[str, float]:
    """Compute BMI, limb thickness and fat: the mean at this BMI and sex plus the sampled deviation."""
    about = {name: limb.clip_to_range(limb.mean_at_bmi(bmi, sex) + sampled[name]) for name, limb in law.limb.items()}
    return {"bmi": bmi, **about}


def _sample_bone_form(
    rng: np.random.Generator, table: RangeGradeTable | SeverityGradeTable, sex: str, mode_count: int
) -> dict[str, Any]:
    """Sample the scores of the modes of bone shape and the positions of the small bones."""
    scores = rng.standard_normal(mode_count).clip(-MAX_SHAPE_SD, MAX_SHAPE_SD)
    form: dict[str, Any] = {"shape": tuple(round(float(score), 4) for score in scores)}
    form |= {name: _sample_normal(rng, law, sex) for name, law in table.form.items()}
    has, size_mm = rng.random() < table.fabella.share, _sample_uniform(rng, table.fabella.size_mm)
    return form | {"fabella_mm": size_mm if has else 0.0}


def _sample_normal(rng: np.random.Generator, law: Pair | dict[str, Pair], sex: str) -> float:
    """Sample a normal distribution (mean, SD), which may depend on sex, with limited scores."""
    mean, sd = law[sex] if isinstance(law, dict) else law
    return round(mean + sd * min(_TRUNCATION_SD, max(-_TRUNCATION_SD, rng.standard_normal())), 4)


def _sample_osteophytes(
    rng: np.random.Generator, count_range: tuple[int, int], largest_range_mm: Pair
) -> tuple[Osteophyte, ...]:
    """Sample the osteophytes of a table of ranges; the first one is the largest."""
    count = int(rng.integers(count_range[0], count_range[1] + 1))
    largest = _sample_uniform(rng, largest_range_mm)
    sites = rng.permutation(len(MARGIN_AND_SPINE_SITES))
    shares = rng.uniform(0.3, 1.0, len(MARGIN_AND_SPINE_SITES))
    shares[0] = 1.0
    sized = [(MARGIN_AND_SPINE_SITES[sites[i]], round(largest * float(shares[i]), 4)) for i in range(count)]
    # Osteophytes below 0.2 mm are left out: they cannot be distinguished from the natural rounding of the margin, nor
    # seen in a pixel of 0.15 mm.
    return tuple(Osteophyte(site=site, size_mm=size) for site, size in sized if size >= 0.2)


def _sample_uniform(rng: np.random.Generator, bounds: Pair) -> float:
    """Sample a uniform distribution between two bounds."""
    return round(float(rng.uniform(bounds[0], bounds[1])), 4)
