"""Films to test models on, beside a cohort."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from ..core.checks import InputError, require
from ..io.films import Film, FilmImage

# With less a region has a compartment's joint space in it and little bone.
REGION_MM = (20.0, 200.0)


@dataclass(frozen=True, kw_only=True)
class FilmSet:
    """Films, and how the models that are tested on them are to be trained.

    load         `Film.file` -> the film as it is displayed; picklable for more than one worker
    load_cohort  entry of the manifest's column `file` -> that radiograph, as a film of it would be displayed
    protocol     of the cohort, that the models learn from: one near the films'
    pixel_mm     pitch that films and cohort are brought to; None: the films' own, or the protocol's if that is coarser
    region_mm    side of the region; None: what nine of ten films hold, at most the study's
    raises       InputError without a film, or for a pitch or side out of range
    """

    films: tuple[Film, ...]
    load: Callable[[str], FilmImage]
    load_cohort: Callable[[str], FilmImage]
    protocol: str
    pixel_mm: float | None = None
    region_mm: float | None = None

    def __post_init__(self) -> None:
        if not self.films:
            raise InputError("films = none; allowed: one or more")
        if self.pixel_mm is not None:
            require("films' pixel_mm", self.pixel_mm, 0.02, 20, "mm")
        if self.region_mm is not None:
            require("films' region_mm", self.region_mm, *REGION_MM, "mm")
        files: set[str] = set()
        for film in self.films:
            if not isinstance(film, Film):
                raise InputError(f"films must be of type Film, as list_films gives them, got {film!r}")
            if film.file in files:
                raise InputError(f"films: file = {film.file!r}, twice; allowed: each file once")
            files.add(film.file)

    def facts(self) -> dict[str, Any]:
        """What results depend on, for JSON."""
        films = [asdict(film) for film in self.films]
        chosen = {name: getattr(self, name) for name in ("protocol", "pixel_mm", "region_mm")}
        return {"films": films, **chosen}
