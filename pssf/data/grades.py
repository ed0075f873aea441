"""Records of a table of grades: what a sampled knee of a grade may be. `data.grade_tables` reads them."""

from .records import Numbers, Pair, Record, Rows

Laws = tuple[Pair, ...]


class GradeRanges(Record, frozen=True):
    """Bounds of what is drawn evenly; mm, degrees, the plate relative to a healthy one."""

    jsw_medial_mm: Pair
    jsw_lateral_mm: Pair
    osteophyte_count: tuple[int, int]
    largest_osteophyte_mm: Pair
    subchondral_plate: Pair
    varus_deg: Pair


class Fabellae(Record, frozen=True):
    """Share of knees that have a fabella, and bounds of its size."""

    share: float
    size_mm: Pair


class Side(Record, frozen=True):
    """Share of knees that narrow medially, and correlation of severity with what narrows, grows, hardens and slips."""

    medial: float
    shape_with: float


class Spaces(Record, frozen=True):
    """Joint spaces as readers take them, mm: correlation of both, the least drawn, what men have more, laws by side.

    medial, lateral  grade -> mean and deviation of the space that narrows and of the other one
    """

    correlation: float
    least_mm: float
    men_more_mm: float
    medial: dict[str, tuple[Pair, Pair]]
    lateral: dict[str, tuple[Pair, Pair]]


class Around(Record, frozen=True):
    """What else is on the margin of an osteophyte of from_mm or more: in front of it in such a share, and behind it.

    place, size  where between its middle (0) and its end (1), and of the first one's size, between these
    """

    from_mm: float
    share: float
    place: Pair
    size: Pair


class Margins(Record, frozen=True):
    """Latent OARSI grades of osteophytes, by KL grade and site, and the sizes that each stands for, mm.

    spine, spine_other  share of knees whose spine of the narrowed side is spiked, by KL grade; the other's over that
    curve_deg           site -> mean and deviation of how far its lips curve towards the joint
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
    around: Around
    curve_deg: dict[str, Pair]


class Central(Record, frozen=True):
    """Share of knees that have an osteophyte in the middle of a joint surface, by grade, and bounds of its size.

    femur, narrowed  shares of them on the femur, and on the side that narrows
    """

    share: Numbers
    femur: float
    narrowed: float
    size_mm: Pair


class Rest(Record, frozen=True):
    """What else a grade moves: means and deviations, factors and shares by grade."""

    plate: Laws
    varus_deg: Laws
    lean_per_varus: float
    wider: Numbers
    age_years: Laws
    women: Numbers
    bmi_more: Numbers
    density_more: Numbers


class Cysts(Record, frozen=True):
    """Share of knees that have subchondral cysts, by grade; how many then, where, and bounds of their size.

    tibia, narrowed  shares of cysts in the tibia, and on the side that narrows
    """

    share: Numbers
    most: int
    tibia: float
    narrowed: float
    diameter_mm: Pair


class Notch(Record, frozen=True):
    """Mean and deviation of what has grown into the notch by grade, and what it may be."""

    growth_mm: Laws
    bounds_mm: Pair


class Effusion(Record, frozen=True):
    """Mean and deviation of how much the joint is swollen by grade, mm, least and most."""

    swelling_mm: Laws
    bounds_mm: Pair


class SkinFolds(Record, frozen=True):
    """The deepest that a person's folds of skin may be; less is as likely.

    most  rows of BMI, kg/m2, and share of the fat
    """

    most: Rows


class Hip(Record, frozen=True):
    """Where a hip's centre is seen from the knee: mean and deviation of the femur's mechanical axis from its shaft."""

    mechanical_axis_deg: Pair


class Subluxation(Record, frozen=True):
    """Of the tibia to lateral where the medial side narrows, mm: mean and deviation by grade, least and most."""

    lateral_mm: Laws
    bounds_mm: Pair


class Reader(Record, frozen=True):
    """Kappa of the grade that is read with the one that is meant."""

    kappa: float


class SharedGrades(Record, frozen=True):
    """Drawn alike in every grade.

    body   field of a knee -> mean and standard deviation, of both sexes or of each
    pose   field of a knee -> bounds
    form   as body, of what is drawn with the scores of the shape
    """

    body: dict[str, Pair | dict[str, Pair]]
    pose: dict[str, Pair]
    form: dict[str, Pair | dict[str, Pair]]
    fabella: Fabellae


class RangeGrades(SharedGrades, frozen=True):
    """Grades by ranges of each parameter: grade -> its ranges."""

    grade: dict[str, GradeRanges]

    @property
    def grades(self) -> tuple[int, ...]:
        """All grades, rising."""
        return tuple(sorted(int(name) for name in self.grade))


class SeverityGrades(SharedGrades, frozen=True):
    """Grades by a latent severity, which spaces, osteophytes, plate, alignment, growth and slip follow in part."""

    side: Side
    spaces: Spaces
    osteophytes: Margins
    rest: Rest
    reader: Reader
    central: Central | None = None
    cysts: Cysts | None = None
    subluxation: Subluxation | None = None
    notch: Notch | None = None
    effusion: Effusion | None = None
    skin_folds: SkinFolds | None = None
    hip: Hip | None = None

    @property
    def grades(self) -> tuple[int, ...]:
        """All grades, rising."""
        return tuple(range(len(self.rest.wider)))
