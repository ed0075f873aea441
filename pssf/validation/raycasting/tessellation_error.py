"""Error of the projected outlines of femur and tibia by mesh tolerance and number of triangles."""

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

# Number of outline samples per pixel along each axis.
_SUBPIXELS = 4
# Mesh tolerance of the reference outline, in mm.
_REFERENCE_TOLERANCE_MM = 0.004
# Range of rows in which outlines are compared under the protocol `reference`; it excludes the shaft ends.
_COMPARED_ROWS = (512, 1536)


def measure_tessellation_error(
    coarse_tolerances_mm: Sequence[float] = (0.2, 0.1, 0.05), refinement_factors: Sequence[float] = (2, 4)
) -> list[Row]:
    """Measure the error of the projected outlines of the template femur and tibia for several mesh tolerances.

    Outlines are compared in the joint plane under the protocol ``reference``. The reference outline is that of a mesh
    with a tolerance of 0.004 mm, whose vertices are on the same level set.

    Parameters
    ----------
    coarse_tolerances_mm : sequence of float
        Further mesh tolerances to test besides the tolerance in use, in mm.
    refinement_factors : sequence of float
        Factors by which the tolerance in use is divided to obtain finer tolerances to test.

    Returns
    -------
    list of dict
        One row per bone and tolerance: number of triangles, meshing time in seconds, and RMS, 99th percentile and
        maximum of the outline error in mm.
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
    """Measure the perpendicular distances between two projected outlines, in mm in the joint plane.

    The outline at the joint is compared by column, the medial and lateral outlines by row.
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
        # Steep parts of an outline are omitted here, because the comparison along the other axis includes them.
        seen = np.isfinite(away) & np.isfinite(slope) & (np.abs(slope) < 1)
        distances.append(away[seen] / np.sqrt(1 + slope[seen] ** 2))
    return np.concatenate(distances) / _SUBPIXELS * view.pixel_mm / magnification(view)


def _project_vertices(mesh: Mesh, axis: int) -> Array:
    """Project the vertices of a mesh to (n, 2) subpixel positions; the compared coordinate is first."""
    places = project_points(mesh.vertices, resolve_view(load_protocol("reference"))) * _SUBPIXELS
    return places if axis == 0 else places[:, ::-1]
