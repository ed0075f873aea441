"""What a trace gives back: path lengths, and an account of how the rays fared."""

from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..geometry.scene import Scene
from ..geometry.view import View


@dataclass(frozen=True, kw_only=True)
class Audit:
    """Counts of rays, over all surfaces. One ray is one pixel and one surface.

    rays        traced: the pixels in a surface's projected box (scanline), those of them that cross it (embree)
    unbalanced  crossings were missed: fewer than there are, or their signs did not add up to zero
    imprecise   a crossing too near an edge, or too grazing, for float32 to be trusted
    repaired    recomputed in float64 by the scanline engine: every unbalanced and every imprecise one
    unrepaired  unbalanced even then; always 0
    """

    rays: int = 0
    unbalanced: int = 0
    imprecise: int = 0
    repaired: int = 0
    unrepaired: int = 0

    def counts(self) -> dict[str, int]:
        """Name -> count, as for a report or a table."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


@dataclass(frozen=True, kw_only=True)
class Paths:
    """Path lengths of every ray from the source to a pixel centre.

    path_mm  material -> (rows, cols)  chord length inside the material
    view     that the rays were cast by
    texture  "none" where every material was taken at its own density, else "trabecular"
    """

    path_mm: dict[str, NDArray[np.floating]]
    audit: Audit
    view: View
    texture: str
    scene: Scene


def total(audits: Iterable[Audit]) -> Audit:
    """The audits of parts of an image, as one."""
    columns = zip(*map(astuple, audits), strict=True)
    return Audit(**{field.name: sum(column) for field, column in zip(fields(Audit), columns, strict=False)})
