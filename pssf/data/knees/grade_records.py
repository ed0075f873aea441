"""Records of a grade table: parameter distributions of knees of each KL grade, loaded by `grade_tables`."""

from ..table_records import (
    Numbers,
    Pair,
    Record,
    Rows,
)

MeanSdByGrade = tuple[Pair, ...]


class GradeRanges(Record, frozen=True):
    """Parameter ranges of one grade, which are sampled uniformly.

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
        Range of the height of the fabella, in mm, which is sampled uniformly.
    """

    share: float
    size_mm: Pair


class NarrowedSideDistribution(Record, frozen=True):
    """Distribution of the narrowed compartment, and correlation of parameters with the latent severity of a knee.

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
        Correlation between the joint space widths of the two compartments of a knee.
    least_mm : float
        Smallest joint space width, in mm.
    male_excess_mm : float
        Joint space width of men minus that of women, in mm.
    medial : dict of str to ((float, float), (float, float))
        Distributions for knees whose medial compartment narrows, keyed by KL grade: mean and SD of the narrowed
        compartment, then of the other compartment, in mm.
    lateral : dict of str to ((float, float), (float, float))
        Distributions for knees whose lateral compartment narrows, with the same entries.
    """

    correlation: float
    least_mm: float
    male_excess_mm: float
    medial: dict[str, tuple[Pair, Pair]]
    lateral: dict[str, tuple[Pair, Pair]]


class AccompanyingOsteophytes(Record, frozen=True):
    """Distribution of additional osteophytes in front of and behind a large osteophyte on the same margin.

    Attributes
    ----------
    from_mm : float
        Size of the main osteophyte from which additional osteophytes occur, in mm.
    share : float
        Probability of an additional osteophyte, in front and behind each.
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
    """Distributions of osteophytes: a latent value per site determines the OARSI grade, and the grade the size range.

    The latent value is a sum of terms. The thresholds between OARSI grades 0, 1, 2 and 3 are 0, 1 and 2.

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
        Largest osteophyte size in knees of KL 1, in mm.
    spine : tuple of float
        Fraction of knees with an osteophyte on the tibial spine of the narrowed compartment, per KL grade.
    spine_other : float
        Fraction for the tibial spine of the other compartment, relative to the narrowed compartment.
    spine_mm : (float, float)
        Size range of osteophytes on tibial spines, in mm.
    around : AccompanyingOsteophytes
        Additional osteophytes on the same margin.
    curve_deg : dict of str to (float, float)
        Mean and SD of the curvature of osteophytes towards the joint at each site, in degrees.
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
        Fraction of central osteophytes on the femur; the others are on the tibia.
    narrowed : float
        Fraction of central osteophytes in the compartment that narrows.
    size_mm : (float, float)
        Size range, in mm.
    """

    share: Numbers
    femur: float
    narrowed: float
    size_mm: Pair


class GradeCovariates(Record, frozen=True):
    """Other parameters that depend on the KL grade. Every tuple has one entry per grade.

    Attributes
    ----------
    plate : tuple of (float, float)
        Mean and SD of the thickness of the subchondral bone plate, relative to a healthy plate.
    varus_deg : tuple of (float, float)
        Mean and SD of the deformity towards the narrowed compartment, in degrees.
    lean_per_varus : float
        Additional lean of the leg per degree of varus, which keeps the joint line horizontal, in degrees per degree.
    bone_scale_factor : tuple of float
        Factor by which the bone size is multiplied.
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
        Mean and SD of the growth, per KL grade, in mm.
    bounds_mm : (float, float)
        Lower and upper bound, in mm.
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
        Lower and upper bound, in mm.
    """

    swelling_mm: MeanSdByGrade
    bounds_mm: Pair


class SkinFoldLimits(Record, frozen=True):
    """Upper limits of the depth of skin folds, which is sampled uniformly from 0 to the limit.

    Attributes
    ----------
    max_depth_by_bmi : tuple of (float, float)
        Rows of BMI in kg/m2 and upper limit of the depth as a fraction of the fat thickness; limits are interpolated
        linearly.
    """

    max_depth_by_bmi: Rows


class MechanicalAxisDistribution(Record, frozen=True):
    """Distribution of the angle between the shaft of the femur and the mechanical axis through the hip centre.

    Attributes
    ----------
    mechanical_axis_deg : (float, float)
        Mean and SD, in degrees.
    """

    mechanical_axis_deg: Pair


class SubluxationDistribution(Record, frozen=True):
    """Distribution of lateral tibial subluxation in knees whose medial compartment narrows.

    Attributes
    ----------
    lateral_mm : tuple of (float, float)
        Mean and SD of the lateral displacement, per KL grade, in mm.
    bounds_mm : (float, float)
        Lower and upper bound, in mm.
    """

    lateral_mm: MeanSdByGrade
    bounds_mm: Pair


class ReaderAgreement(Record, frozen=True):
    """Agreement of a reader with the KL grade for which a knee was sampled.

    Attributes
    ----------
    kappa : float
        Unweighted Cohen's kappa for equally frequent grades.
    """

    kappa: float


class SharedGradeTable(Record, frozen=True):
    """Distributions that are the same in every grade.

    Attributes
    ----------
    body : dict of str to (float, float) or dict
        Mean and SD of body measures, common to both sexes or per sex, keyed by knee field.
    pose : dict of str to (float, float)
        Ranges of the pose, which are sampled uniformly, keyed by knee field.
    form : dict of str to (float, float) or dict
        Mean and SD of fields that are sampled together with the scores of bone shape, in the same format as `body`.
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
        Parameter ranges, keyed by KL grade as text.
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
        Distribution of the narrowed compartment, and correlation with the severity.
    spaces : JointSpaceDistributions
        Distributions of joint space widths.
    osteophytes : OsteophyteDistributions
        Distributions of osteophytes at joint margins and on tibial spines.
    rest : GradeCovariates
        Subchondral bone plate, alignment, size of the bones, age, sex, BMI and bone density.
    reader : ReaderAgreement
        Agreement of a simulated reader.
    central : CentralOsteophyteDistribution or None
        Distribution of central osteophytes; None if the table has none.
    cysts : CystDistribution or None
        Distribution of subchondral cysts; None if the table has none.
    subluxation : SubluxationDistribution or None
        Distribution of tibial subluxation; None if the table has none.
    notch : NotchGrowthDistribution or None
        Distribution of bone growth into the notch; None if the table has none.
    effusion : EffusionDistribution or None
        Distribution of joint swelling; None if the table has none.
    skin_folds : SkinFoldLimits or None
        Limits of skin folds; None if the table has none.
    hip : MechanicalAxisDistribution or None
        Distribution of the mechanical axis of the femur; None for the default of `Knee`.
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
