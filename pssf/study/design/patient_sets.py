"""Patient radiographs used as an external test set of a study."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from ...core.checks import InputError, require_in_range
from ...io.patients.patient_radiographs import Film, FilmImage

# Allowed side length of a region, in mm. A smaller region shows the joint space of a compartment but little bone.
REGION_RANGE_MM = (20.0, 200.0)


@dataclass(frozen=True, kw_only=True)
class FilmSet:
    """Patient radiographs and settings of the models that are tested on them.

    Parameters
    ----------
    films : tuple of Film
        Patient radiographs; each file is listed once.
    load : callable
        Function that loads a patient radiograph, as displayed, from its `Film.file`. It must be picklable if there is
        more than one worker.
    load_cohort : callable
        Function that loads a cohort radiograph, displayed like a patient radiograph, from an entry of the manifest's
        column ``file``.
    protocol : str
        Protocol of the cohort radiographs used for training; choose one similar to the patients' protocol.
    pixel_mm : float, optional
        Pixel pitch to which all radiographs are resampled, 0.02 to 20 mm. None uses the median pitch of the patient
        radiographs or the pitch of the protocol, whichever is larger.
    region_mm : float, optional
        Side length of the region, 20 to 200 mm. None uses the largest side length that fits in 90 % of the patient
        radiographs, but at most the side length in the study.

    Raises
    ------
    InputError
        There is no patient radiograph, an entry is not a `Film`, a file is listed twice, or a number is out of range.
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
                raise InputError(f"films must be of type Film, as returned by list_films, got {film!r}")
            if film.file in files:
                raise InputError(f"films must list each file once, got {film.file!r} twice")
            files.add(film.file)

    def to_json_dict(self) -> dict[str, Any]:
        """Convert the fields that the results depend on to JSON types.

        Returns
        -------
        dict of str to Any
            Patient radiographs, protocol, pixel pitch and side length of the region.
        """
        films = [asdict(film) for film in self.films]
        chosen = {name: getattr(self, name) for name in ("protocol", "pixel_mm", "region_mm")}
        return {"films": films, **chosen}
