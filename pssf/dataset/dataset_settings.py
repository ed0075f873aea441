"""Settings of a data set."""

from dataclasses import asdict, dataclass
from typing import Any

from ..core.checks import InputError, require_choice, require_in_range, require_integer, require_seed
from ..detector.display_rendering import DISPLAY_PROCESSING
from ..raycast import ENGINES
from .randomisation import resolve_transforms

# Names of the subsets, in the order in which subjects are assigned to them.
SPLITS = ("train", "validation", "test")
# Kinds of image files that a data set can contain.
IMAGE_KINDS = ("linear", "display")
# Arrangements of the files.
LAYOUTS = ("folder", "shards")
# Kinds of paired images.
PAIRS = ("none", "protocol", "lesion", "visit")


@dataclass(frozen=True, kw_only=True)
class DatasetSettings:
    """Settings of a data set.

    The same settings, code and library versions give byte-identical files for any number of workers.

    Attributes
    ----------
    images : int
        Number of images, 1 to 100 million. It is rounded up to a whole number of subjects.
    seed : int
        Seed of all random numbers.
    matrix : int
        Number of pixels along the longer side of an image; 0: as in the protocol.
    protocols : tuple of str
        Names or files of protocols. Each knee is imaged with one of them at random. ``pairs = "protocol"`` needs
        exactly two.
    grade_table : str
        Name or file of the grade table.
    grades : {"balanced", "prevalence"}
        ``"balanced"`` gives every KL grade of the table the same number of subjects. ``"prevalence"`` samples the
        grades with their frequency in the Osteoarthritis Initiative.
    knees_per_subject : int
        1, or 2 for both knees of a subject, which are sampled for the same KL grade.
    acquisition : {"sampled", "fixed"}
        ``"sampled"`` varies positioning, beam angle, source-detector distance, kV, mAs, collimated field and side
        marker between images.
    equipment : {"nominal", "sampled"}
        ``"sampled"`` varies focal spot and filtration between images, and the grid of protocols with a grid;
        ``"nominal"`` uses the values of the protocol.
    display : {"sampled", "processed", "log", "film"}
        Display processing of 8-bit images; ``"sampled"`` varies it between images.
    kinds : tuple of str
        Kinds of image files: ``"linear"`` (16-bit TIFF) and ``"display"`` (8-bit PNG).
    crop_mm : float
        Side of a square crop around the joint, on the detector, in mm; 0: whole images. With a crop, `matrix` is the
        number of pixels per side of the crop, and the pixel size is `crop_mm` / `matrix`.
    crop_shift_mm : float
        Standard deviation of the random shift of the crop in each direction, in mm. Shifts are clipped at two standard
        deviations.
    split : tuple of float
        Fractions of subjects for training, validation and test.
    randomise : tuple of str
        Names of transforms and recipes of `randomisation` that are applied after the physics.
    pairs : {"none", "protocol", "lesion", "visit"}
        Kind of paired images: the same knee with two protocols, with and without one lesion, or at two visits. The
        second knee of a lesion or visit pair can have another grade.
    maps : tuple of str
        Materials with a path length map, in mm.
    layout : {"folder", "shards"}
        ``"folder"`` writes single files. ``"shards"`` writes tar files in WebDataset format.
    shard_images : int
        Target number of images per shard. A subject is never divided between shards, so a shard can contain fewer or
        more images.
    parquet : bool
        Also write the index as Parquet, which needs the extra ``parquet``.
    engine : {"scanline", "embree"}
        Ray caster.

    Raises
    ------
    InputError
        If a value is not allowed.
    """

    images: int = 500
    seed: int = 0
    matrix: int = 512
    protocols: tuple[str, ...] = ("fixed_flexion",)
    grade_table: str = "population"
    grades: str = "balanced"
    knees_per_subject: int = 1
    acquisition: str = "sampled"
    equipment: str = "nominal"
    display: str = "sampled"
    kinds: tuple[str, ...] = ("linear", "display")
    crop_mm: float = 0.0
    crop_shift_mm: float = 3.0
    split: tuple[float, float, float] = (0.7, 0.15, 0.15)
    randomise: tuple[str, ...] = ()
    pairs: str = "none"
    maps: tuple[str, ...] = ()
    layout: str = "folder"
    shard_images: int = 100
    parquet: bool = False
    engine: str = "scanline"

    def __post_init__(self) -> None:
        require_integer("images", self.images, 1, 100_000_000, "")
        require_seed(self.seed)
        require_integer("matrix", self.matrix, 0, 8192, "pixels")
        require_integer("knees_per_subject", self.knees_per_subject, 1, 2, "")
        require_choice("grades", self.grades, ("balanced", "prevalence"))
        require_choice("acquisition", self.acquisition, ("sampled", "fixed"))
        require_choice("equipment", self.equipment, ("nominal", "sampled"))
        require_choice("display", self.display, ("sampled", *DISPLAY_PROCESSING))
        require_choice("pairs", self.pairs, PAIRS)
        require_choice("layout", self.layout, LAYOUTS)
        require_choice("engine", self.engine, ENGINES)
        require_integer("shard_images", self.shard_images, 1, 20_000, "")
        for kind in self.kinds:
            require_choice("kinds", kind, IMAGE_KINDS)
        if not self.kinds:
            raise InputError(f"kinds must be one or more of {', '.join(IMAGE_KINDS)}, got none")
        require_in_range("crop_shift_mm", self.crop_shift_mm, 0, 50, "mm")
        if self.crop_mm:
            require_in_range("crop_mm", self.crop_mm, 20, 1000, "mm")
        if (
            len(self.split) != len(SPLITS)
            or not all(part >= 0 for part in self.split)
            or not abs(sum(self.split) - 1) < 1e-6
        ):
            given = ", ".join(f"{part:g}" for part in self.split)
            raise InputError(f"split must be three fractions (train, validation, test) with the sum 1, got {given}")
        if not self.protocols:
            raise InputError("protocols must be one or more names, got protocols = none")
        if self.pairs == "protocol" and len(self.protocols) != 2:
            count = len(self.protocols)
            raise InputError(f"protocols must be exactly two names for pairs = protocol, got {count}")
        resolve_transforms(self.randomise)

    @property
    def images_per_subject(self) -> int:
        """Number of images of one subject."""
        return self.knees_per_subject * (1 if self.pairs == "none" else 2)

    @property
    def subject_count(self) -> int:
        """Number of subjects."""
        return -(-self.images // self.images_per_subject)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON-ready values.

        Returns
        -------
        dict of str to object
            Values keyed by field name.
        """
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}
