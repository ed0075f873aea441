"""Patient radiographs used as an external test set of a study."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from ...core.checks import InputError, require_in_range
from ...io.patients.patient_radiographs import Film, FilmImage

# Allowed side length of a region, in mm; assumed. A smaller region shows the joint space of one compartment but little
# bone.
REGION_RANGE_MM = (20.0, 200.0)


@dataclass(frozen=True, kw_only=True)
class FilmSet:
    """Patient radiographs of an external test set, and settings of the models that are tested on the radiographs.

    Parameters
    ----------
    films : tuple of Film
        Patient radiographs; each file is listed once.
    load : callable
        Function that loads a patient radiograph as displayed, for an entry of `Film.file`. It must be picklable if
        there is more than one worker.
    load_cohort : callable
        Function that loads a cohort radiograph, displayed like a patient radiograph, for an entry of the manifest
        column ``file``.
    protocol : str
        Protocol of the cohort radiographs used for training; it should be similar to the protocol of the patient
        radiographs.
    pixel_mm : float, optional
        Pixel pitch to which all radiographs are resampled, 0.02 to 20 mm. If None, the larger of the protocol pitch and
        the median pitch of the patient radiographs is used.
    region_mm : float, optional
        Side length of the region, 20 to 200 mm. If None, the largest side length that fits in 90 % of the patient
        radiographs is used, up to the side length in the study.

    Raises
    ------
    InputError
        There are no patient radiographs, an entry is not a `Film`, a file is listed twice, or a number is out of range.
    """

    films: tuple[Film, ...]
    load: Callable[[str], FilmImage]
    load_cohort: Callable[[str], FilmImage]
    protocol: str
    pixel_mm: float | None = None
    region_mm: float | None = None

    def __post_init__(self) -> None:
        if not self.films:
            raise InputError(f"films must contain at least one patient radiograph, got {len(self.films)}")
        if self.pixel_mm is not None:
            require_in_range("films' pixel_mm", self.pixel_mm, 0.02, 20, "mm")
        if self.region_mm is not None:
            require_in_range("films' region_mm", self.region_mm, *REGION_RANGE_MM, "mm")
        files: set[str] = set()
        for film in self.films:
            if not isinstance(film, Film):
                raise InputError(f"films must contain Film objects from list_films, got {film!r}")
            if film.file in files:
                raise InputError(f"films must list each file once, got {film.file!r} twice")
            files.add(film.file)

    def to_json_dict(self) -> dict[str, Any]:
        """Convert the fields that affect the results to JSON types.

        Returns
        -------
        dict of str to Any
            Patient radiographs, protocol, pixel pitch and side length of the region.
        """
        films = [asdict(film) for film in self.films]
        chosen = {name: getattr(self, name) for name in ("protocol", "pixel_mm", "region_mm")}
        return {"films": films, **chosen}
