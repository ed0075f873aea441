"""Error of the projected outlines of femur and tibia by number of triangles."""

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from ...anatomy.meshing.implicit_shapes import project_solid
from ...anatomy.meshing.solids import extract_mesh, find_edges
from ...anatomy.outlines.projected_contours import compute_outline_rows
from ...anatomy.template.template_femur import make_template_femur
from ...anatomy.template.template_tibia import make_template_tibia
from ...core.checks import Array
from ...data.anatomy.anatomy_tables import load_anatomy_tables
from ...geometry.mesh import Mesh
from ...geometry.view import magnification, project_points, resolve_view
from ...model.protocol import load_protocol
from .raycast_engines import Row

# Number of outline samples per pixel.
_SUBPIXELS = 4
# Mesh tolerance of the reference outline, in mm.
_REFERENCE_TOLERANCE_MM = 0.004
# Rows within which outlines are compared under the protocol `reference`; the shaft ends are outside.
_COMPARED_ROWS = (512, 1536)


def measure_tessellation_error(
    coarse_tolerances_mm: Sequence[float] = (0.2, 0.1, 0.05), refinement_factors: Sequence[float] = (2, 4)
) -> list[Row]:
    """Measure how far the projected outlines of the template femur and tibia deviate, by mesh tolerance.

    Outlines are compared in the joint plane under the protocol ``reference``. The exact outline is that of a mesh ten
    times finer, with its vertices on the same level set.

    Parameters
    ----------
    coarse_tolerances_mm : sequence of float
        Mesh tolerances, in mm, that are tested beside the one in use.
    refinement_factors : sequence of float
        Factors by which the tolerance in use is divided for further tests.

    Returns
    -------
    list of dict
        One row per bone and tolerance: triangles, seconds, and RMS, 99th percentile and maximum of the deviation in mm.
    """
    rows: list[Row] = []
    tables = load_anatomy_tables()
    shape, forms = tables.template, tables.shape_model
    for mean, lowest in (
        (make_template_femur(shape.femur, forms), 1.0),
        (make_template_tibia(shape.tibia, forms), -1.0),
    ):
        exact = extract_mesh(
            project_solid(mean.mesh_to_tolerance(_REFERENCE_TOLERANCE_MM).refine(2), mean.field, steps=3)
        )
        usual = mean.tolerance_mm
        for tolerance_mm in (*coarse_tolerances_mm, usual, *(usual / times for times in refinement_factors)):
            start = perf_counter()
            solid = mean.mesh_to_tolerance(tolerance_mm)
            seconds = perf_counter() - start
            off = _outline_distances_mm(extract_mesh(solid), exact, lowest)
            rows.append({
                "bone": mean.name, "tolerance_mm": tolerance_mm, "used": tolerance_mm == usual,
                "triangles": solid.num_tri(), "seconds": round(seconds, 2),
                "rms_mm": float(f"{np.sqrt(np.mean(off**2)):.2g}"), "p99_mm": float(f"{np.percentile(off, 99):.2g}"),
                "max_mm": float(f"{off.max():.2g}"),
            })  # fmt: skip
    return rows


def _outline_distances_mm(coarse: Mesh, exact: Mesh, end_sign: float) -> Array:
    """Measure the distances between two outlines, perpendicular to them, in mm in the joint plane.

    The joint side is compared column by column, the sides of the bone row by row.
    """
    view = resolve_view(load_protocol("reference"))
    distances = []
    for axis, sign, (first, last) in (
        (0, end_sign, (0, view.cols)),
        (1, 1.0, _COMPARED_ROWS),
        (1, -1.0, _COMPARED_ROWS),
    ):
        one, other = (
            compute_outline_rows(
                _project_vertices(mesh, axis),
                find_edges(mesh.faces),
                first * _SUBPIXELS,
                (last - first) * _SUBPIXELS,
                sign,
            )
            for mesh in (coarse, exact)
        )
        with np.errstate(invalid="ignore"):
            slope, away = np.gradient(other), np.abs(one - other)
        # Where an outline is steep along this axis, the comparison along the other axis covers it.
        seen = np.isfinite(away) & np.isfinite(slope) & (np.abs(slope) < 1)
        distances.append(away[seen] / np.sqrt(1 + slope[seen] ** 2))
    return np.concatenate(distances) / _SUBPIXELS * view.pixel_mm / magnification(view)


def _project_vertices(mesh: Mesh, axis: int) -> Array:
    """Project the vertices of a mesh to (n, 2) subpixels, with the axis of comparison first."""
    places = project_points(mesh.vertices, resolve_view(load_protocol("reference"))) * _SUBPIXELS
    return places if axis == 0 else places[:, ::-1]
