"""Error of the projected outlines of femur and tibia against their triangles."""

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from ..anatomy.contours import envelope
from ..anatomy.femur import mean_femur
from ..anatomy.implicit import project_solid
from ..anatomy.solids import edges_of, mesh_of
from ..anatomy.tibia import mean_tibia
from ..core.checks import Array
from ..data.anatomy import anatomy_tables
from ..geometry.mesh import Mesh
from ..geometry.view import magnification, project, view_of
from ..model.protocol import load_protocol
from .engines import Row

# Fractions of a pixel at which outlines are compared, and what counts as exact.
_FINER = 4
_EXACT_MM = 0.004
# Rows within which outlines are compared, in the protocol `reference`: the ends of the shafts are outside.
_ROWS = (512, 1536)


def tessellation_rows(coarse_mm: Sequence[float] = (0.2, 0.1, 0.05), finer: Sequence[float] = (2, 4)) -> list[Row]:
    """One row a bone and tolerance: triangles, seconds, and how far the outline of the mean man's bone is off, mm.

    The outline is seen under the protocol `reference`, in the joint plane; the exact one is that of a mesh ten times as
    fine, whose vertices lie on the same level set.
    coarse_mm  tolerances that are tried beside the one that is used
    finer      and so many times less than that
    """
    rows: list[Row] = []
    tables = anatomy_tables()
    shape, forms = tables.shape, tables.forms
    for mean, lowest in ((mean_femur(shape.femur, forms), 1.0), (mean_tibia(shape.tibia, forms), -1.0)):
        exact = mesh_of(project_solid(mean.meshed(_EXACT_MM).refine(2), mean.field, steps=3))
        usual = mean.tolerance_mm
        for tolerance_mm in (*coarse_mm, usual, *(usual / times for times in finer)):
            start = perf_counter()
            solid = mean.meshed(tolerance_mm)
            seconds = perf_counter() - start
            off = _off_mm(mesh_of(solid), exact, lowest)
            rows.append({
                "bone": mean.name, "tolerance_mm": tolerance_mm, "used": tolerance_mm == usual,
                "triangles": solid.num_tri(), "seconds": round(seconds, 2),
                "rms_mm": float(f"{np.sqrt(np.mean(off**2)):.2g}"), "p99_mm": float(f"{np.percentile(off, 99):.2g}"),
                "max_mm": float(f"{off.max():.2g}"),
            })  # fmt: skip
    return rows


def _off_mm(coarse: Mesh, exact: Mesh, lowest: float) -> Array:
    """Distances between two outlines, across them: at the joint from column to column, at the sides from row to row."""
    view = view_of(load_protocol("reference"))
    distances = []
    for axis, sign, (first, last) in ((0, lowest, (0, view.cols)), (1, 1.0, _ROWS), (1, -1.0, _ROWS)):
        one, other = (
            envelope(_seen(mesh, axis), edges_of(mesh.faces), first * _FINER, (last - first) * _FINER, sign)
            for mesh in (coarse, exact)
        )
        with np.errstate(invalid="ignore"):
            slope, away = np.gradient(other), np.abs(one - other)
        # Where an outline runs along the way it is looked up, the other way sees it.
        seen = np.isfinite(away) & np.isfinite(slope) & (np.abs(slope) < 1)
        distances.append(away[seen] / np.sqrt(1 + slope[seen] ** 2))
    return np.concatenate(distances) / _FINER * view.pixel_mm / magnification(view)


def _seen(mesh: Mesh, axis: int) -> Array:
    places = project(mesh.vertices, view_of(load_protocol("reference"))) * _FINER
    return places if axis == 0 else places[:, ::-1]
