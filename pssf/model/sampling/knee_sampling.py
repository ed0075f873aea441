"""Sample a knee or a pair of knees with a requested KL grade from a grade table."""

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

# Name of the default grade table.
DEFAULT_GRADE_TABLE = "population"
# Limit to which standard scores are clipped, in standard deviations.
_TRUNCATION_SD = 2.0
# Knee fields that have the same value in both knees of a person.
_SHARED_FIELDS = (
    "sex", "stature_mm", "bone_scale", "cortex_scale", "bmi", "limb_ap_mm", "fat_mm", "skin_folds", "age_years",
    "bone_density", "shape", "fibular_tip_mm", "insall_salvati", "fabella_mm", "mechanical_axis_deg",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class KneeDistributions:
    """Distributions from which knees are sampled.

    Attributes
    ----------
    table : str
        Name of the grade table, or file name of a user-defined table.
    grades : RangeGradeTable or SeverityGradeTable
        Grade table.
    mode_count : int
        Number of bone shape modes.
    limbs : LimbStatistics
        BMI distribution, and dependence of limb and fat thickness on BMI and sex.
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
    """Load a grade table, together with the distributions that are common to all grade tables.

    Parameters
    ----------
    table : str
        Name of a built-in grade table, or path of a TOML file.

    Returns
    -------
    KneeDistributions
        Grade table and common distributions.

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
    """Sample a knee with a requested KL grade from a grade table.

    Parameters
    ----------
    grade : int
        Requested KL grade: 0 to 4 with the grade table ``population``, 0 to 2 with ``paper``.
    rng : int or numpy.random.Generator
        Seed or generator; the only source of randomness. Size and pose are sampled from the generator. Texture seed,
        bone shape and BMI are sampled from child generators.
    grade_table : str, default "population"
        Name of a built-in grade table, or path of a user-defined TOML file. In ``population``, grades overlap as in
        patients, and `Knee.jsw_definition` is "read". In ``paper``, the joint space width alone distinguishes grades 0
        to 2.
    **fixed : object
        Fixed values of `Knee` fields. A fixed value does not change other sampled fields, with two exceptions: sizes
        depend on `sex`, and limb and fat thickness depend on `bmi`.

    Returns
    -------
    Knee
        Sampled knee.

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
    """Check that a grade table contains a grade; if not, the error message lists built-in tables with this grade."""
    whole = isinstance(grade, Integral) and not isinstance(grade, bool)
    if whole and grade in distributions.grades.grades:
        return
    hint = f": grade table {', '.join(tables_with_grade)} has it" if whole and tables_with_grade else ""
    allowed = ", ".join(map(str, distributions.grades.grades))
    raise InputError(f"grade must be one of {allowed} in grade table {distributions.table}, got {grade!r}{hint}")


def sample_knee_from_distributions(
    distributions: KneeDistributions, *, grade: int, rng: np.random.Generator, **fixed: Any
) -> Knee:
    """Sample a knee like `sample_knee`, but from loaded distributions.

    Parameters
    ----------
    distributions : KneeDistributions
        Result of `load_knee_distributions`.
    grade : int
        KL grade.
    rng : numpy.random.Generator
        Generator; the only source of randomness.
    **fixed : object
        Fields of `Knee` with fixed values.

    Returns
    -------
    Knee
        Sampled knee.

    Raises
    ------
    InputError
        If the grade table does not contain the grade, or a fixed field or value is not allowed.
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
    # `texture_seed` and `form_seed` can share one seed, because texture and bone form use independent random streams.
    drawn["texture_seed"] = drawn["form_seed"] = int(rng.spawn(1)[0].integers(2**63))
    # The remaining fields use child generators, so that they do not change the fields sampled before.
    drawn |= _sample_bone_form(rng.spawn(1)[0], law, sex, distributions.mode_count)
    if isinstance(law, SeverityGradeTable):
        drawn |= sample_severity_fields(law, int(grade), sex, drawn["bone_scale"], rng.spawn(1)[0])
        # A varus leg leans more, so that the joint line remains horizontal.
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
    """Sample skin fold depth and femoral mechanical axis angle, if the grade table defines their distributions."""
    sampled = {}
    if law.skin_folds is not None:
        most = np.interp(bmi, *np.array(law.skin_folds.max_depth_by_bmi).T)
        sampled["skin_folds"] = round(float(most) * rng.spawn(1)[0].random(), 4)
    if law.hip is not None:
        angle_deg = _sample_normal(rng.spawn(1)[0], law.hip.mechanical_axis_deg, sex)
        sampled["mechanical_axis_deg"] = float(np.clip(angle_deg, 1.0, 9.0))
    return sampled


def sample_knees(distributions: KneeDistributions, count: int, seed: int, **fixed: Any) -> list[Knee]:
    """Sample knees whose KL grades cycle through all grades of a grade table.

    Parameters
    ----------
    distributions : KneeDistributions
        Result of `load_knee_distributions`.
    count : int
        Number of knees.
    seed : int
        Seed; the random stream of knee k depends only on the seed and on k.
    **fixed : object
        Fields of `Knee` with fixed values.

    Returns
    -------
    list of Knee
        Sampled knees.

    Raises
    ------
    InputError
        If a fixed field or value is not allowed.
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
    """Sample the right and left knee of a person with the same KL grade.

    Parameters
    ----------
    grade : int
        KL grade of both knees; the allowed grades are those of `sample_knee`.
    rng : int or numpy.random.Generator
        Seed or generator; the only source of randomness.
    grade_table : str, default "population"
        Name of a built-in grade table, or path of a user-defined TOML file; see `sample_knee`.
    **fixed : object
        Fixed values of `Knee` fields in both knees; `side` is not allowed.

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
    Both knees have the same sex, stature, age, BMI, limb and fat thickness, and skin folds. Size, shape, cortex and
    density of the bones, fibula and patella height, fabella and mechanical axis are also the same. Joint spaces,
    alignment, osteophytes and pose are sampled separately.

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
    """Sample the knee fields that have the same value in both knees of a person.

    Parameters
    ----------
    distributions : KneeDistributions
        Result of `load_knee_distributions`.
    grade : int
        KL grade of both knees.
    rng : numpy.random.Generator
        Random generator for this person.
    **fixed : object
        Fields of `Knee` with fixed values.

    Returns
    -------
    dict of str to object
        Sampled values keyed by `Knee` field.

    Raises
    ------
    InputError
        If the grade table does not contain the grade, or a fixed field or value is not allowed.
    """
    body = sample_knee_from_distributions(distributions, grade=grade, rng=rng, **fixed)
    return {name: getattr(body, name) for name in _SHARED_FIELDS}


def _compute_limb_sizes(bmi: float, sex: str, sampled: dict[str, Any], law: LimbStatistics) -> dict[str, float]:
    """Add the sampled deviations to the mean limb and fat thickness for BMI and sex; return BMI and thicknesses."""
    about = {name: limb.clip_to_range(limb.mean_at_bmi(bmi, sex) + sampled[name]) for name, limb in law.limb.items()}
    return {"bmi": bmi, **about}


def _sample_bone_form(
    rng: np.random.Generator, table: RangeGradeTable | SeverityGradeTable, sex: str, mode_count: int
) -> dict[str, Any]:
    """Sample the bone shape scores, and the positions of fibula, patella and fabella."""
    scores = rng.standard_normal(mode_count).clip(-MAX_SHAPE_SD, MAX_SHAPE_SD)
    form: dict[str, Any] = {"shape": tuple(round(float(score), 4) for score in scores)}
    form |= {name: _sample_normal(rng, law, sex) for name, law in table.form.items()}
    has, size_mm = rng.random() < table.fabella.share, _sample_uniform(rng, table.fabella.size_mm)
    return form | {"fabella_mm": size_mm if has else 0.0}


def _sample_normal(rng: np.random.Generator, law: Pair | dict[str, Pair], sex: str) -> float:
    """Sample a normal distribution (mean, SD) that may depend on sex; clip the value at 2 SD."""
    mean, sd = law[sex] if isinstance(law, dict) else law
    return round(mean + sd * min(_TRUNCATION_SD, max(-_TRUNCATION_SD, rng.standard_normal())), 4)


def _sample_osteophytes(
    rng: np.random.Generator, count_range: tuple[int, int], largest_range_mm: Pair
) -> tuple[Osteophyte, ...]:
    """Sample osteophytes from a count range and a size range; the first osteophyte is the largest."""
    count = int(rng.integers(count_range[0], count_range[1] + 1))
    largest = _sample_uniform(rng, largest_range_mm)
    sites = rng.permutation(len(MARGIN_AND_SPINE_SITES))
    shares = rng.uniform(0.3, 1.0, len(MARGIN_AND_SPINE_SITES))
    shares[0] = 1.0
    sized = [(MARGIN_AND_SPINE_SITES[sites[i]], round(largest * float(shares[i]), 4)) for i in range(count)]
    # Osteophytes below 0.2 mm are removed, because a pixel of 0.15 mm does not show them, and because they cannot be
    # distinguished from the natural rounding of the margin.
    return tuple(Osteophyte(site=site, size_mm=size) for site, size in sized if size >= 0.2)


def _sample_uniform(rng: np.random.Generator, bounds: Pair) -> float:
    """Sample a uniform distribution between a lower and an upper bound."""
    return round(float(rng.uniform(bounds[0], bounds[1])), 4)
