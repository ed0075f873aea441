"""Records of a grade table: distributions of the parameters of knees of each KL grade (read by `grade_tables`)."""

from ..table_records import (
    Numbers,
    Pair,
    Record,
    Rows,
)

MeanSdByGrade = tuple[Pair, ...]


class GradeRanges(Record, frozen=True):
    """Ranges of the parameters of one grade, which are sampled uniformly.

    Attributes
    ----------
    jsw_medial_mm : (float, float)
        Medial joint space width, in mm.
    jsw_lateral_mm : (float, float)
        Lateral joint space width, in mm.
    osteophyte_count : (int, int)
        Number of osteophytes.
    largest_osteophyte_mm : (float, float)
        Size of the largest osteophyte, in mm.
    subchondral_plate : (float, float)
        Thickness of the subchondral bone plate relative to a healthy one.
    varus_deg : (float, float)
        Varus angle beyond the normal valgus, in degrees.
    """

    jsw_medial_mm: Pair
    jsw_lateral_mm: Pair
    osteophyte_count: tuple[int, int]
    largest_osteophyte_mm: Pair
    subchondral_plate: Pair
    varus_deg: Pair


class FabellaDistribution(Record, frozen=True):
    """Frequency and size of the fabella.

    Attributes
    ----------
    share : float
        Fraction of knees that have a fabella.
    size_mm : (float, float)
        Range of its height, in mm; sampled uniformly.
    """

    share: float
    size_mm: Pair


class NarrowedSideDistribution(Record, frozen=True):
    """Side of the narrowed compartment, and correlation of a knee's parameters with its latent severity.

    Attributes
    ----------
    medial : float
        Fraction of knees in which the medial compartment narrows.
    severity_correlation : float
        Correlation of the latent severity with joint space, osteophytes, subchondral bone plate, alignment, notch
        growth, effusion and subluxation.
    """

    medial: float
    severity_correlation: float


class JointSpaceDistributions(Record, frozen=True):
    """Distributions of joint space widths as readers measure them.

    Attributes
    ----------
    correlation : float
        Correlation of the two compartments of a knee.
    least_mm : float
        Smallest joint space width, in mm.
    male_excess_mm : float
        Joint space width of men minus that of women, in mm.
    medial : dict of str to ((float, float), (float, float))
        KL grade -> mean and SD of the narrowed and of the other compartment, in mm, if the medial one narrows.
    lateral : dict of str to ((float, float), (float, float))
        The same if the lateral compartment narrows.
    """

    correlation: float
    least_mm: float
    male_excess_mm: float
    medial: dict[str, tuple[Pair, Pair]]
    lateral: dict[str, tuple[Pair, Pair]]


class AccompanyingOsteophytes(Record, frozen=True):
    """Further osteophytes on the same margin, in front of a large osteophyte and behind it.

    Attributes
    ----------
    from_mm : float
        Size of an osteophyte from which it has others beside it, in mm.
    share : float
        Probability of another one, at each end.
    place : (float, float)
        Range of its position along the margin, from the middle (0) to the end (1).
    size : (float, float)
        Range of its size, relative to the first one.
    """

    from_mm: float
    share: float
    place: Pair
    size: Pair


class OsteophyteDistributions(Record, frozen=True):
    """Distributions of osteophytes: a latent value per site is cut into OARSI grades, which have ranges of size.

    The latent value is the sum of the terms below and is cut at 0, 1 and 2.

    Attributes
    ----------
    level : tuple of float
        Mean of the latent value, per KL grade.
    site : dict of str to float
        Site -> offset of the latent value.
    narrowed_side : float
        Offset of the latent value on the side that narrows.
    person_sd : float
        SD of the latent value between knees.
    site_sd : float
        SD of the latent value between the sites of a knee.
    size_mm : tuple of (float, float)
        Range of size of OARSI grades 0, 1, 2 and 3, in mm.
    doubtful_mm : float
        Largest size in knees of KL 1, in mm.
    spine : tuple of float
        Fraction of knees with an osteophyte on the tibial spine of the narrowed side, per KL grade.
    spine_other : float
        Fraction for the spine of the other side, relative to that of the narrowed side.
    spine_mm : (float, float)
        Range of size of osteophytes on tibial spines, in mm.
    around : AccompanyingOsteophytes
        Further osteophytes on the same margin.
    curve_deg : dict of str to (float, float)
        Site -> mean and SD of the curve of the osteophyte towards the joint, in degrees.
    """

    level: Numbers
    site: dict[str, float]
    narrowed_side: float
    person_sd: float
    site_sd: float
    size_mm: tuple[Pair, Pair, Pair, Pair]
    doubtful_mm: float
    spine: Numbers
    spine_other: float
    spine_mm: Pair
    around: AccompanyingOsteophytes
    curve_deg: dict[str, Pair]


class CentralOsteophyteDistribution(Record, frozen=True):
    """Frequency, position and size of central osteophytes, which are in the middle of a joint surface.

    Attributes
    ----------
    share : tuple of float
        Fraction of knees with a central osteophyte, per KL grade.
    femur : float
        Fraction of these that are on the femur; the others are on the tibia.
    narrowed : float
        Fraction of these that are in the compartment that narrows.
    size_mm : (float, float)
        Range of size, in mm.
    """

    share: Numbers
    femur: float
    narrowed: float
    size_mm: Pair


class GradeCovariates(Record, frozen=True):
    """Further parameters that depend on the KL grade; every tuple has one entry per grade.

    Attributes
    ----------
    plate : tuple of (float, float)
        Mean and SD of the thickness of the subchondral bone plate, relative to a healthy one.
    varus_deg : tuple of (float, float)
        Mean and SD of the deformity towards the narrowed side, in degrees.
    lean_per_varus : float
        Lean of the leg per degree of varus, which keeps the joint line level; in degrees per degree.
    bone_scale_factor : tuple of float
        Factor of the size of the bones.
    age_years : tuple of (float, float)
        Mean and SD of age, in years.
    women : tuple of float
        Fraction of women.
    bmi_offset : tuple of float
        BMI minus the mean of the population, in kg/m2.
    density_offset : tuple of float
        Relative density of trabecular bone minus the mean of the population.
    """

    plate: MeanSdByGrade
    varus_deg: MeanSdByGrade
    lean_per_varus: float
    bone_scale_factor: Numbers
    age_years: MeanSdByGrade
    women: Numbers
    bmi_offset: Numbers
    density_offset: Numbers


class CystDistribution(Record, frozen=True):
    """Frequency, position and size of subchondral cysts.

    Attributes
    ----------
    share : tuple of float
        Fraction of knees with cysts, per KL grade.
    max_count : int
        Largest number of cysts per knee.
    tibia : float
        Fraction of cysts that are in the tibia; the others are in the femur.
    narrowed : float
        Fraction of cysts that are in the compartment that narrows.
    diameter_mm : (float, float)
        Range of the inner diameter, in mm.
    """

    share: Numbers
    max_count: int
    tibia: float
    narrowed: float
    diameter_mm: Pair


class NotchGrowthDistribution(Record, frozen=True):
    """Growth of bone into the intercondylar notch.

    Attributes
    ----------
    growth_mm : tuple of (float, float)
        Mean and SD of the growth, per KL grade, in mm.
    bounds_mm : (float, float)
        Lower and upper bound, in mm.
    """

    growth_mm: MeanSdByGrade
    bounds_mm: Pair


class EffusionDistribution(Record, frozen=True):
    """Swelling of the joint.

    Attributes
    ----------
    swelling_mm : tuple of (float, float)
        Mean and SD of the additional thickness of capsule, synovium and fluid, per KL grade, in mm.
    bounds_mm : (float, float)
        Lower and upper bound, in mm.
    """

    swelling_mm: MeanSdByGrade
    bounds_mm: Pair


class SkinFoldLimits(Record, frozen=True):
    """Depth of skin folds, which is sampled uniformly from 0 to a limit.

    Attributes
    ----------
    max_depth_by_bmi : tuple of (float, float)
        Rows of BMI, in kg/m2, and limit of the depth, as a fraction of the fat beneath; interpolated linearly.
    """

    max_depth_by_bmi: Rows


class MechanicalAxisDistribution(Record, frozen=True):
    """Angle between the shaft of the femur and its mechanical axis, which points to the centre of the hip.

    Attributes
    ----------
    mechanical_axis_deg : (float, float)
        Mean and SD, in degrees.
    """

    mechanical_axis_deg: Pair


class SubluxationDistribution(Record, frozen=True):
    """Lateral subluxation of the tibia in knees whose medial compartment narrows.

    Attributes
    ----------
    lateral_mm : tuple of (float, float)
        Mean and SD of the displacement to lateral, per KL grade, in mm.
    bounds_mm : (float, float)
        Lower and upper bound, in mm.
    """

    lateral_mm: MeanSdByGrade
    bounds_mm: Pair


class ReaderAgreement(Record, frozen=True):
    """Agreement of a reader with the KL grade that a knee was sampled for.

    Attributes
    ----------
    kappa : float
        Cohen's kappa, unweighted, if all grades are equally frequent.
    """

    kappa: float


class SharedGradeTable(Record, frozen=True):
    """Distributions that are the same in every grade.

    Attributes
    ----------
    body : dict of str to (float, float) or dict
        Knee field -> mean and SD, for both sexes or for each.
    pose : dict of str to (float, float)
        Knee field -> range, which is sampled uniformly.
    form : dict of str to (float, float) or dict
        As `body`, for fields that are sampled together with the scores of the bones' shape.
    fabella : FabellaDistribution
        Frequency and size of the fabella.
    """

    body: dict[str, Pair | dict[str, Pair]]
    pose: dict[str, Pair]
    form: dict[str, Pair | dict[str, Pair]]
    fabella: FabellaDistribution


class RangeGradeTable(SharedGradeTable, frozen=True):
    """Grade table in which each grade has ranges of its parameters.

    Attributes
    ----------
    grade : dict of str to GradeRanges
        KL grade, as text -> ranges.
    """

    grade: dict[str, GradeRanges]

    @property
    def grades(self) -> tuple[int, ...]:
        """All KL grades, in increasing order."""
        return tuple(sorted(int(name) for name in self.grade))


class SeverityGradeTable(SharedGradeTable, frozen=True):
    """Grade table in which the parameters of a knee correlate with one latent severity.

    Attributes
    ----------
    side : NarrowedSideDistribution
        Side that narrows, and correlation with the severity.
    spaces : JointSpaceDistributions
        Joint space widths.
    osteophytes : OsteophyteDistributions
        Osteophytes at margins and on tibial spines.
    rest : GradeCovariates
        Subchondral bone plate, alignment, size of the bones, age, sex, BMI and bone density.
    reader : ReaderAgreement
        Agreement of a reader.
    central : CentralOsteophyteDistribution or None
        Central osteophytes; None for none.
    cysts : CystDistribution or None
        Subchondral cysts; None for none.
    subluxation : SubluxationDistribution or None
        Subluxation of the tibia; None for none.
    notch : NotchGrowthDistribution or None
        Growth into the notch; None for none.
    effusion : EffusionDistribution or None
        Swelling of the joint; None for none.
    skin_folds : SkinFoldLimits or None
        Skin folds; None for none.
    hip : MechanicalAxisDistribution or None
        Mechanical axis of the femur; None for the default of `Knee`.
    """

    side: NarrowedSideDistribution
    spaces: JointSpaceDistributions
    osteophytes: OsteophyteDistributions
    rest: GradeCovariates
    reader: ReaderAgreement
    central: CentralOsteophyteDistribution | None = None
    cysts: CystDistribution | None = None
    subluxation: SubluxationDistribution | None = None
    notch: NotchGrowthDistribution | None = None
    effusion: EffusionDistribution | None = None
    skin_folds: SkinFoldLimits | None = None
    hip: MechanicalAxisDistribution | None = None

    @property
    def grades(self) -> tuple[int, ...]:
        """All KL grades, in increasing order."""
        return tuple(range(len(self.rest.bone_scale_factor)))
