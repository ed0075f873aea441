"""Comparison of scatter behind step wedges with the CTSimU test suite for radiographic simulators (BAM)."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh

from ...core.checks import Array
from ...data.imaging.ctsimu_table import CtsimuTable, WedgeReference, load_ctsimu
from ...geometry.scene import Scene, Surface
from ...image_faults import ImageNotice
from ...simulation import simulate
from .ctsimu_wedges import STEPS, compare_with_codes, compute_wedge_signals, list_path_lengths_mm, make_wedge_protocol

Row = dict[str, Any]
# Photons of a Monte Carlo simulation.
PHOTONS = 10_000_000
# Side of the cells in which scatter is counted, in pixels of the suite's detector, and number of rows and columns.
_CELL_PX, _ROWS, _COLS = 10, 91, 104
# Half the width of the regions in which scatter is averaged, in mm.
_REGION_MM = 48.0
# Margin of the regions to the edges of a step, in pixels of the suite's detector.
_MARGIN_PX = 20
# Gap between steps on the detector, in mm.
_GAP_MM = 0.02
# Number of facets along each side of a step.
_FACETS = 8


def compare_scatter_with_ctsimu(photons: int = PHOTONS) -> list[Row]:
    """Compare the signal with scatter behind the aluminium wedges with two Monte Carlo codes.

    Parameters
    ----------
    photons : int, default 10,000,000
        Number of simulated photons per wedge.

    Returns
    -------
    list of dict
        One row per beam and detector. ``steps_within`` counts the steps, including the free beam, whose signal with
        scatter is within one standard deviation of the grey values of at least one of the codes. ``deviation_percent``
        is the largest deviation from the mean of the codes, and ``scatter_ratio_low`` and ``scatter_ratio_high`` are
        the smallest and the largest ratio of the scatter of a step to that of the codes, the thinnest step excepted.
        ``scatter_ratio`` is the mean of this ratio, and ``free_beam_ratio`` is that in the free beam.
    """
    table = load_ctsimu()
    return [_compare_total(wedge, table, photons) for wedge in table.wedge if wedge.rosi_total]


def compute_wedge_scatter(wedge: WedgeReference, table: CtsimuTable, photons: int, rng: int = 0) -> Array:
    """Simulate the scatter behind the steps of a wedge and in the free beam.

    Parameters
    ----------
    wedge : WedgeReference
        Wedge, beam and detector.
    table : CtsimuTable
        Table with the geometry of the wedge.
    photons : int
        Number of simulated photons.
    rng : int, default 0
        Seed of the simulation.

    Returns
    -------
    (10,) float64 array
        Scatter from the thickest step to the free beam, relative to the primary signal of the open beam at the same
        place.
    """
    geometry = table.geometry
    protocol = replace(
        make_wedge_protocol(wedge, table),
        rows=_ROWS,
        cols=_COLS,
        pixel_mm=_CELL_PX * geometry.pixel_mm,
        sdd_mm=geometry.sdd_mm,
        sod_mm=geometry.middle_mm,
        focal_spot_mm=0.0,
        scatter="monte_carlo",
        scatter_photons=photons,
        noise="none",
        detector_blur="none",
        marker="none",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ImageNotice)
        kept = simulate(
            make_wedge_scene(wedge.material, table), protocol, rng=rng, keep=("scatter", "primary"), engine="scanline"
        ).kept
    scatter, regions = kept["scatter"], _list_regions(table)
    half = round(_REGION_MM / protocol.pixel_mm)
    columns = slice(_COLS // 2 - half, _COLS // 2 + half)
    # The free beam is the last region. The primary signal of the open beam follows the inverse-square law.
    heights = _step_centres_mm(table)
    open_beam = (1 + (heights / geometry.sdd_mm) ** 2) ** -1.5
    middle = slice(_COLS // 2 - 1, _COLS // 2 + 1)
    primary = kept["primary"][regions[-1], middle].mean() * open_beam / open_beam[-1]
    return np.asarray(np.array([scatter[rows, columns].mean() for rows in regions]) / primary, np.float64)


def make_wedge_scene(material: str, table: CtsimuTable) -> Scene:
    """Make a step wedge of parts of spherical shells around the source.

    Parameters
    ----------
    material : str
        Symbol of the material.
    table : CtsimuTable
        Table with the geometry and the path lengths of the steps.

    Returns
    -------
    Scene
        Nine steps, the thickest distal, at the distances of the table from a source at y = -middle_mm.
    """
    geometry, known = table.geometry, table.material[material]
    half = geometry.pixels_per_step * geometry.pixel_mm / 2 - _GAP_MM / 2
    surfaces = []
    steps = zip(_step_centres_mm(table)[:-1], list_path_lengths_mm(known), strict=True)
    for number, (centre, mm) in enumerate(steps):
        radii = (geometry.middle_mm - mm / 2, geometry.middle_mm + mm / 2)
        across, along = (-geometry.width_mm / 2, geometry.width_mm / 2), (centre - half, centre + half)
        mesh = _make_shell_part(radii, across, along, geometry.sdd_mm)
        mesh.apply_translation((0, -geometry.middle_mm, 0))
        surfaces.append(Surface(mesh, f"{material}@{known.density_g_per_cm3}", "air", f"step_{number}"))
    return Scene(surfaces)


def _step_centres_mm(table: CtsimuTable) -> Array:
    """Compute the heights (10,) of the centres of steps and free beam on the detector, in mm."""
    step_mm = table.geometry.pixels_per_step * table.geometry.pixel_mm
    return np.asarray(step_mm * (np.arange(STEPS + 1) - STEPS / 2), np.float64)


def _list_regions(table: CtsimuTable) -> list[slice]:
    """List the rows of cells of each step and of the free beam."""
    step_px = table.geometry.pixels_per_step
    regions = []
    for number in range(STEPS + 1):
        top = (STEPS - number) * step_px
        regions.append(slice((top + _MARGIN_PX) // _CELL_PX, -(-(top + step_px - _MARGIN_PX) // _CELL_PX)))
    return regions


def _make_shell_part(
    radii_mm: tuple[float, float], across_mm: tuple[float, float], along_mm: tuple[float, float], sdd_mm: float
) -> trimesh.Trimesh:
    """Make the part of a spherical shell around the origin that projects to a rectangle of the detector."""
    x, z = np.meshgrid(np.linspace(*across_mm, _FACETS + 1), np.linspace(*along_mm, _FACETS + 1), indexing="ij")
    directions = np.stack((x, np.full_like(x, sdd_mm), z), axis=-1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    vertices = np.concatenate([(directions * radius).reshape(-1, 3) for radius in radii_mm])
    count = (_FACETS + 1) ** 2
    index = np.arange(count).reshape(_FACETS + 1, _FACETS + 1)
    corners = [part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])]
    inner = np.concatenate((np.column_stack(corners[:3]), np.column_stack((corners[0], *corners[2:]))))
    rim = np.concatenate((index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]))
    following = np.roll(rim, -1)
    sides = np.concatenate(
        (np.column_stack((rim, rim + count, following)), np.column_stack((following, rim + count, following + count)))
    )
    mesh = trimesh.Trimesh(vertices, np.concatenate((inner, inner[:, ::-1] + count, sides)), process=False)
    trimesh.repair.fix_normals(mesh)
    return mesh


def _compare_total(wedge: WedgeReference, table: CtsimuTable, photons: int) -> Row:
    """Make the table row of one wedge."""
    free_beams = np.array([[wedge.rosi[-1]], [wedge.mcray[-1]]])
    codes = np.array([wedge.rosi_total, wedge.mcray_total]) / free_beams
    spread = np.array([wedge.rosi_total_sd, wedge.mcray_total_sd]) / free_beams
    primary = (np.array([wedge.rosi, wedge.mcray]) / free_beams).mean(axis=0)
    scatter = compute_wedge_scatter(wedge, table, photons)
    total = compute_wedge_signals(wedge, table) + scatter
    ratio = scatter / (codes.mean(axis=0) - primary)
    thick = ratio[: STEPS - 1]
    return {
        "detector": wedge.detector.replace("_", " "),
        "wedge": wedge.material,
        "beam": wedge.beam,
        **compare_with_codes(total, codes, spread),
        "scatter_ratio": round(float(thick.mean()), 3),
        "scatter_ratio_low": round(float(thick.min()), 3),
        "scatter_ratio_high": round(float(thick.max()), 3),
        "free_beam_ratio": round(float(ratio[-1]), 3),
    }
