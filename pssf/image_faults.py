"""Warnings about a simulated radiograph: materials, field of view, saturation and landmarks."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from .core.checks import InputError
from .data.anatomy.tissue_table import DENSEST_GAS_G_PER_CM3
from .geometry.scene import Scene
from .model.radiograph import Truth
from .raycast import compute_scene_silhouette
from .xray.alloys import describe_alloy_misreading
from .xray.collimator import field_half_size_mm, is_collimated
from .xray.resolved_technique import Technique

# Fraction of saturated pixels in the object above which a warning is issued.
_SATURATED = 0.001
# Width of the margin inside the object outline that is excluded from the saturation check, in mm on the detector.
_RIM_MM = 5.0
# Number of sample points along the shorter side of the detector for the saturation check.
_PLACES = 300
# Maximum number of landmark names in a warning.
_MAX_NAMED_LANDMARKS = 3
# Substrings in the names of landmarks that need not be visible in an axial view, which shows patella and trochlea.
_IGNORED_AXIAL_LANDMARKS = ("plateau", "fibula")


class ImageNotice(UserWarning):
    """Warning that a radiograph may not be as the user intended. The message contains the cause and a remedy."""


def require_materials(scene: Scene, technique: Technique) -> None:
    """Raise an error if a material is unknown or the ambient material is not a gas.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials.
    technique : Technique
        Resolved protocol, with the tissue table.

    Raises
    ------
    InputError
        If a material is unknown, or if the ambient material is denser than a gas. The message contains the material.
    """
    for name in scene.materials:
        technique.material(name)
    density = technique.material(scene.ambient).density_g_per_cm3
    if density > DENSEST_GAS_G_PER_CM3:
        raise InputError(
            f"ambient must be air or another gas, got {scene.ambient!r} ({density:g} g/cm3): the ambient material "
            f"does not attenuate; add a closed surface around the scene, Surface(box, {scene.ambient!r}, 'air')"
        )


def find_material_faults(scene: Scene, technique: Technique) -> list[str]:
    """Find chemical formulas of materials that may be intended as alloy names.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials.
    technique : Technique
        Resolved protocol, with the tissue table.

    Returns
    -------
    list of str
        One warning for each formula.
    """
    said = (describe_alloy_misreading(name, technique.tissues) for name in scene.materials)
    return [one for one in said if one is not None]


def find_field_faults(path_mm: Mapping[str, Any], technique: Technique) -> list[str]:
    """Check whether any ray in the irradiated field intersects the scene.

    Parameters
    ----------
    path_mm : mapping of str to (rows, cols) array, mm
        Path length in each material, as arrays or sparse maps.
    technique : Technique
        Resolved protocol, which defines the irradiated field.

    Returns
    -------
    list of str
        List with one warning if no ray intersects the scene; otherwise, an empty list.
    """
    rows, cols = _irradiated_slices(technique)
    if is_collimated(technique.protocol):
        seen = any(lengths[rows][:, cols].any() for lengths in path_mm.values())
    else:
        seen = any(lengths.max() > 0 for lengths in path_mm.values())
    if seen or not path_mm:
        return []
    return [
        "the scene is outside the field of view, so the image shows only the open beam; move the meshes of the scene "
        "towards the origin, or move the beam (centre_x_mm, centre_z_mm)"
    ]


def find_saturation_faults(pixels: NDArray[np.uint16], scene: Scene, technique: Technique) -> list[str]:
    """Check whether more than 0.1 % of the object's pixels are saturated; a margin along the outline is excluded.

    Parameters
    ----------
    pixels : (rows, cols) uint16 array, DN
        Pixel values.
    scene : Scene
        Closed surfaces.
    technique : Technique
        Resolved protocol.

    Returns
    -------
    list of str
        List with one warning if too many pixels are saturated; otherwise, an empty list.
    """
    full = pixels >= technique.detector.saturation_dn
    if not full.any():
        return []
    # A few hundred sample points along each side are sufficient to estimate the fraction of saturated pixels.
    view = technique.view
    step = max(1, min(view.rows, view.cols) // _PLACES)
    sparse = replace(view, rows=view.rows // step, cols=view.cols // step, pixel_mm=view.pixel_mm * step)
    covered = compute_scene_silhouette(scene, sparse)
    # The margin is excluded, because most exposures saturate the detector at the outline, where an object is thin.
    within = distance_transform_edt(np.pad(covered, 1, mode="edge"))[1:-1, 1:-1] * sparse.pixel_mm > _RIM_MM
    covered = within if within.any() else covered
    seen = full[step // 2 :: step, step // 2 :: step][: sparse.rows, : sparse.cols]
    fraction = float((seen & covered).sum() / max(int(covered.sum()), 1))
    if not fraction > _SATURATED:
        return []
    return [
        f"{100 * fraction:.1f} % of the object's pixels are saturated ({technique.detector.saturation_dn} DN) and "
        f"contain no information; reduce mas (now {technique.protocol.mas:g}) or tube_kv"
    ]


def find_landmark_faults(truths: Iterable[Truth], technique: Technique) -> list[str]:
    """Check whether all landmarks are inside the irradiated image.

    Parameters
    ----------
    truths : iterable of Truth
        Labels of all knees in the radiograph.
    technique : Technique
        Resolved protocol, which defines the image and its irradiated field.

    Returns
    -------
    list of str
        List with one warning if landmarks are outside the irradiated image; otherwise, an empty list.
    """
    rows, cols = _irradiated_slices(technique)
    beside = _IGNORED_AXIAL_LANDMARKS if technique.protocol.projection == "axial" else ()
    outside = [
        name
        for truth in truths
        for name, (row, col) in truth.landmarks_px.items()
        if not any(part in name for part in beside)
        and not (rows.start <= row + 0.5 < rows.stop and cols.start <= col + 0.5 < cols.stop)
    ]
    if not outside:
        return []
    named = ", ".join(outside[:_MAX_NAMED_LANDMARKS]) + (", ..." if len(outside) > _MAX_NAMED_LANDMARKS else "")
    where = "irradiated field" if is_collimated(technique.protocol) else "image"
    return [
        f"{len(outside)} landmarks are outside the {where} ({named}), so the radiograph does not show the labelled "
        "positions; enlarge the field or move the beam (centre_x_mm, centre_z_mm)"
    ]


def _irradiated_slices(technique: Technique) -> tuple[slice, slice]:
    """Return the detector rows and columns in the collimated field, or all rows and columns without collimation."""
    view = technique.view
    half_width, half_height = field_half_size_mm(technique)
    sides = []
    for count, half_mm in ((view.rows, half_height), (view.cols, half_width)):
        half = half_mm / view.pixel_mm
        sides.append(slice(max(0, int(np.floor(count / 2 - half))), min(count, int(np.ceil(count / 2 + half)))))
    return sides[0], sides[1]
