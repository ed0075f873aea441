"""Record types of grade tables, which define the distributions of knee parameters for each KL grade."""

from ..table_records import (
    Numbers,
    Pair,
    Record,
    Rows,
)

MeanSdByGrade = tuple[Pair, ...]


class GradeRanges(Record, frozen=True):
    """Parameter ranges for uniform sampling of knees of one KL grade.

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
        Thickness of the subchondral bone plate relative to a healthy plate.
    varus_deg : (float, float)
        Varus angle relative to the normal valgus, in degrees.
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
        Fraction of knees with a fabella.
    size_mm : (float, float)
        Range for uniform sampling of the fabella height, in mm.
    """

    share: float
    size_mm: Pair


class NarrowedSideDistribution(Record, frozen=True):
    """Frequency of medial narrowing, and correlation of knee parameters with the latent severity.

    Attributes
    ----------
    medial : float
        Fraction of knees in which the medial compartment narrows.
    severity_correlation : float
        Correlation of the latent severity with joint space, osteophytes, subchondral bone plate, alignment, bone growth
        into the notch, effusion and subluxation.
    """

    medial: float
    severity_correlation: float


class JointSpaceDistributions(Record, frozen=True):
    """Distributions of the joint space widths that readers measure.

    Attributes
    ----------
    correlation : float
        Correlation between the joint space widths of the two compartments of a knee.
    least_mm : float
        Lower limit of sampled joint space widths, in mm.
    male_excess_mm : float
        Mean joint space width of men minus the mean of women, in mm.
    medial : dict of str to ((float, float), (float, float))
        Joint space widths of knees with medial narrowing, in mm, keyed by KL grade. Each entry has the mean and SD of
        the medial compartment, followed by the mean and SD of the lateral compartment.
    lateral : dict of str to ((float, float), (float, float))
        Joint space widths of knees with lateral narrowing, in mm, keyed by KL grade. Each entry has the mean and SD of
        the lateral compartment, followed by the mean and SD of the medial compartment.
    """

    correlation: float
    least_mm: float
    male_excess_mm: float
    medial: dict[str, tuple[Pair, Pair]]
    lateral: dict[str, tuple[Pair, Pair]]


class AccompanyingOsteophytes(Record, frozen=True):
    """Distribution of additional osteophytes that are anterior and posterior to a large marginal osteophyte.

    Attributes
    ----------
    from_mm : float
        Smallest size of a main osteophyte that may have additional osteophytes, in mm.
    share : float
        Probability of an additional osteophyte, separately for the anterior and the posterior position.
    place : (float, float)
        Range of the position of an additional osteophyte along the margin, from the middle (0) to the end (1).
    size : (float, float)
        Range of the size of an additional osteophyte, relative to the main osteophyte.
    """

    from_mm: float
    share: float
    place: Pair
    size: Pair


class OsteophyteDistributions(Record, frozen=True):
    """Distributions of osteophyte sizes, based on a latent value for each site.

    The latent value is a sum of the terms below. It determines the OARSI grade, and the OARSI grade determines the size
    range. The thresholds of the latent value between OARSI grades 0, 1, 2 and 3 are 0, 1 and 2.

    Attributes
    ----------
    level : tuple of float
        Mean of the latent value, per KL grade.
    site : dict of str to float
        Offset of the latent value for each site.
    narrowed_side : float
        Offset of the latent value in the compartment that narrows.
    person_sd : float
        SD of the latent value between knees.
    site_sd : float
        SD of the latent value between the sites of a knee.
    size_mm : tuple of (float, float)
        Size ranges of OARSI grades 0, 1, 2 and 3, in mm.
    doubtful_mm : float
        Largest osteophyte size in knees with KL grade 1, in mm.
    spine : tuple of float
        Fraction of knees with an osteophyte on the tibial spine of the narrowed compartment, per KL grade.
    spine_other : float
        Factor that converts `spine` to the fraction for the tibial spine of the other compartment.
    spine_mm : (float, float)
        Size range of osteophytes on tibial spines, in mm.
    around : AccompanyingOsteophytes
        Distribution of additional osteophytes near a large osteophyte.
    curve_deg : dict of str to (float, float)
        Mean and SD of the angle by which osteophytes curve towards the joint, in degrees, keyed by site.
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
    """Frequency, position and size of central osteophytes, which grow in the middle of a joint surface.

    Attributes
    ----------
    share : tuple of float
        Fraction of knees with a central osteophyte, per KL grade.
    femur : float
        Fraction of central osteophytes on the femur; the others are on the tibia.
    narrowed : float
        Fraction of central osteophytes in the compartment that narrows.
    size_mm : (float, float)
        Size range of central osteophytes, in mm.
    """

    share: Numbers
    femur: float
    narrowed: float
    size_mm: Pair


class GradeCovariates(Record, frozen=True):
    """Parameters, other than joint space and osteophytes, that depend on the KL grade.

    Every tuple has one entry per grade.

    Attributes
    ----------
    plate : tuple of (float, float)
        Mean and SD of the thickness of the subchondral bone plate, relative to a healthy plate.
    varus_deg : tuple of (float, float)
        Mean and SD of the angular deformity towards the narrowed compartment, in degrees.
    lean_per_varus : float
        Additional lean of the leg for each degree of varus, in degrees per degree. The lean keeps the joint line
        horizontal.
    bone_scale_factor : tuple of float
        Scale factor of the bone size, relative to the population.
    age_years : tuple of (float, float)
        Mean and SD of age, in years.
    women : tuple of float
        Fraction of women.
    bmi_offset : tuple of float
        Mean BMI minus the population mean, in kg/m2.
    density_offset : tuple of float
        Mean relative density of trabecular bone minus the population mean.
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
        Maximum number of cysts per knee.
    tibia : float
        Fraction of cysts in the tibia; the others are in the femur.
    narrowed : float
        Fraction of cysts in the compartment that narrows.
    diameter_mm : (float, float)
        Range of the inner diameter, in mm.
    """

    share: Numbers
    max_count: int
    tibia: float
    narrowed: float
    diameter_mm: Pair


class NotchGrowthDistribution(Record, frozen=True):
    """Distribution of bone growth into the intercondylar notch.

    Attributes
    ----------
    growth_mm : tuple of (float, float)
        Mean and SD of the bone growth, per KL grade, in mm.
    bounds_mm : (float, float)
        Lower and upper bound of the bone growth, in mm.
    """

    growth_mm: MeanSdByGrade
    bounds_mm: Pair


class EffusionDistribution(Record, frozen=True):
    """Distribution of joint swelling due to effusion.

    Attributes
    ----------
    swelling_mm : tuple of (float, float)
        Mean and SD of the additional thickness of capsule, synovium and fluid, per KL grade, in mm.
    bounds_mm : (float, float)
        Lower and upper bound of the additional thickness, in mm.
    """

    swelling_mm: MeanSdByGrade
    bounds_mm: Pair


class SkinFoldLimits(Record, frozen=True):
    """Upper limits of the skin fold depth, which is sampled uniformly from 0 to the limit.

    Attributes
    ----------
    max_depth_by_bmi : tuple of (float, float)
        Rows of BMI, in kg/m2, and upper limit of the skin fold depth, as a fraction of the fat thickness. Limits
        between rows are interpolated linearly.
    """

    max_depth_by_bmi: Rows


class MechanicalAxisDistribution(Record, frozen=True):
    """Distribution of the angle between the femoral shaft and the mechanical axis through the hip centre.

    Attributes
    ----------
    mechanical_axis_deg : (float, float)
        Mean and SD of the angle, in degrees.
    """

    mechanical_axis_deg: Pair


class SubluxationDistribution(Record, frozen=True):
    """Distribution of lateral tibial subluxation in knees whose medial compartment narrows.

    Attributes
    ----------
    lateral_mm : tuple of (float, float)
        Mean and SD of the lateral displacement of the tibia, per KL grade, in mm.
    bounds_mm : (float, float)
        Lower and upper bound of the lateral displacement, in mm.
    """

    lateral_mm: MeanSdByGrade
    bounds_mm: Pair


class ReaderAgreement(Record, frozen=True):
    """Agreement between a simulated reader and the true KL grade of a knee.

    Attributes
    ----------
    kappa : float
        Unweighted Cohen's kappa in a cohort with equally frequent grades.
    """

    kappa: float


class SharedGradeTable(Record, frozen=True):
    """Distributions that are the same in every grade.

    Attributes
    ----------
    body : dict of str to (float, float) or dict
        Mean and SD of body measures, keyed by knee field. A dict contains one mean and SD for each sex.
    pose : dict of str to (float, float)
        Ranges for uniform sampling of pose parameters, keyed by knee field.
    form : dict of str to (float, float) or dict
        Mean and SD of knee fields that are sampled jointly with the bone shape scores, in the same format as `body`.
    fabella : FabellaDistribution
        Frequency and size of the fabella.
    """

    body: dict[str, Pair | dict[str, Pair]]
    pose: dict[str, Pair]
    form: dict[str, Pair | dict[str, Pair]]
    fabella: FabellaDistribution


class RangeGradeTable(SharedGradeTable, frozen=True):
    """Grade table that defines parameter ranges for each grade.

    Attributes
    ----------
    grade : dict of str to GradeRanges
        Parameter ranges, keyed by KL grade as a string.
    """

    grade: dict[str, GradeRanges]

    @property
    def grades(self) -> tuple[int, ...]:
        """All KL grades of the table, in increasing order."""
        return tuple(sorted(int(name) for name in self.grade))


class SeverityGradeTable(SharedGradeTable, frozen=True):
    """Grade table in which the parameters of a knee correlate with a latent severity.

    Attributes
    ----------
    side : NarrowedSideDistribution
        Frequency of medial narrowing, and correlation of knee parameters with the latent severity.
    spaces : JointSpaceDistributions
        Distributions of joint space widths.
    osteophytes : OsteophyteDistributions
        Distributions of osteophytes at joint margins and on tibial spines.
    rest : GradeCovariates
        Distributions of subchondral bone plate thickness, alignment, bone size, age, sex, BMI and bone density.
    reader : ReaderAgreement
        Agreement between a simulated reader and the true KL grade.
    central : CentralOsteophyteDistribution or None
        Distribution of central osteophytes; None if the table does not contain this entry.
    cysts : CystDistribution or None
        Distribution of subchondral cysts; None if the table does not contain this entry.
    subluxation : SubluxationDistribution or None
        Distribution of tibial subluxation; None if the table does not contain this entry.
    notch : NotchGrowthDistribution or None
        Distribution of bone growth into the notch; None if the table does not contain this entry.
    effusion : EffusionDistribution or None
        Distribution of joint swelling; None if the table does not contain this entry.
    skin_folds : SkinFoldLimits or None
        Limits of the skin fold depth; None if the table does not contain this entry.
    hip : MechanicalAxisDistribution or None
        Distribution of the mechanical axis angle of the femur; None to use the default of `Knee`.
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
        """All KL grades of the table, in increasing order."""
        return tuple(range(len(self.rest.bone_scale_factor)))
