"""Patient radiographs used as an external test set beside a cohort."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from ...core.checks import InputError, require_in_range
from ...io.patients.patient_radiographs import Film, FilmImage

# Allowed side of a region, in mm. A smaller region shows the joint space of a compartment but little bone.
REGION_RANGE_MM = (20.0, 200.0)


@dataclass(frozen=True, kw_only=True)
class FilmSet:
    """Patient radiographs and how the models tested on them are trained.

    Parameters
    ----------
    films : tuple of Film
        Patient radiographs, each file once.
    load : callable
        Function from `Film.file` to the patient radiograph as displayed (FilmImage). It must be picklable for more than
        one worker.
    load_cohort : callable
        Function from an entry of the manifest's column ``file`` to that radiograph as a FilmImage, displayed like a
        patient radiograph.
    protocol : str
        Protocol of the cohort that the models are trained on; choose one similar to the patients' protocol.
    pixel_mm : float, optional
        Pixel pitch that all radiographs are resampled to, 0.02 to 20 mm. None uses the median pitch of the patient
        radiographs, or the pitch of the protocol if that is coarser.
    region_mm : float, optional
        Side of the region, 20 to 200 mm. None uses the largest side that fits nine of ten patient radiographs, at most
        the side in the study.

    Raises
    ------
    InputError
        There is no patient radiograph, an entry is no `Film`, a file is listed twice, or a pitch or side is out of
        range.
    """

    films: tuple[Film, ...]
    load: Callable[[str], FilmImage]
    load_cohort: Callable[[str], FilmImage]
    protocol: str
    pixel_mm: float | None = None
    region_mm: float | None = None

    def __post_init__(self) -> None:
        if not self.films:
            raise InputError(f"films must hold at least one patient radiograph, got {len(self.films)}")
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
        """Convert everything that the results depend on to JSON types.

        Returns
        -------
        dict of str to Any
            Patient radiographs, protocol, pixel pitch and side of the region.
        """
        films = [asdict(film) for film in self.films]
        chosen = {name: getattr(self, name) for name in ("protocol", "pixel_mm", "region_mm")}
        return {"films": films, **chosen}
