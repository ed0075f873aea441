"""Faults of a radiograph that was made as asked: materials, field of view, saturation, landmarks outside of it."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from .core.checks import InputError
from .data.tissues import DENSEST_GAS
from .detector.panel import MOST_DN
from .geometry.scene import Scene
from .model.radiograph import Truth
from .raycast import scene_shadow
from .xray.alloys import alloy_mistaken_for_compound
from .xray.collimator import field_half_mm, is_collimated
from .xray.technique import Technique

# Fraction of the object's pixels that may be saturated without a warning; how far within its outline they begin, in mm
# on the detector; and places at which it is looked at, along the shorter side.
_SATURATED, _RIM_MM, _PLACES = 0.001, 5.0, 300
_NAMED = 3
# A view along the leg is taken of patella and trochlea; these bones may go on beyond it.
_BESIDE_AXIAL = ("plateau", "fibula")


class ImageNotice(UserWarning):
    """The radiograph is made as asked, but may not be what was meant; the message says why and what to do."""


def require_materials(scene: Scene, technique: Technique) -> None:
    """Refuse materials that are unknown, and an ambient one that would attenuate.

    Raises
    ------
    InputError
        Naming the material.
    """
    for name in scene.materials:
        technique.material(name)
    density = technique.material(scene.ambient).density_g_per_cm3
    if density > DENSEST_GAS:
        raise InputError(
            f"ambient must be air or another gas, got {scene.ambient!r} ({density:g} g/cm3), which attenuates nothing "
            f"outside of all surfaces: put the scene into a closed surface, Surface(box, {scene.ambient!r}, 'air')"
        )


def material_faults(scene: Scene, technique: Technique) -> list[str]:
    """Describe formulas that look like names of alloys, a sentence each."""
    said = (alloy_mistaken_for_compound(name, technique.tissues) for name in scene.materials)
    return [one for one in said if one is not None]


def field_faults(path_mm: Mapping[str, Any], technique: Technique) -> list[str]:
    """Describe a scene that no ray of the field of view meets; nothing if one does.

    path_mm  material -> (rows, cols)  path lengths, mm, as arrays or in strips
    """
    rows, cols = _lit(technique)
    if is_collimated(technique.protocol):
        seen = any(lengths[rows][:, cols].any() for lengths in path_mm.values())
    else:
        seen = any(lengths.max() > 0 for lengths in path_mm.values())
    if seen or not path_mm:
        return []
    return [
        "the scene is outside the field of view; the image shows the open beam alone; move the scene (a Scene stays "
        "where its meshes are, in mm about the origin) or the beam (centre_x_mm, centre_z_mm)"
    ]


def saturation_faults(pixels: NDArray[np.uint16], scene: Scene, technique: Technique) -> list[str]:
    """Describe saturation of more than a thousandth of the object's pixels, its outline aside, or nothing.

    pixels  (rows, cols)  counts, as read out
    """
    full = pixels >= MOST_DN
    if not full.any():
        return []
    # A few hundred places to either side are enough for the fraction.
    view = technique.view
    step = max(1, min(view.rows, view.cols) // _PLACES)
    sparse = replace(view, rows=view.rows // step, cols=view.cols // step, pixel_mm=view.pixel_mm * step)
    covered = scene_shadow(scene, sparse)
    # Along the outline an object is as thin as can be, and any usual exposure saturates there.
    within = distance_transform_edt(np.pad(covered, 1, mode="edge"))[1:-1, 1:-1] * sparse.pixel_mm > _RIM_MM
    covered = within if within.any() else covered
    seen = full[step // 2 :: step, step // 2 :: step][: sparse.rows, : sparse.cols]
    fraction = float((seen & covered).sum() / max(int(covered.sum()), 1))
    if not fraction > _SATURATED:
        return []
    return [
        f"{100 * fraction:.1f} % of the object's pixels are saturated ({MOST_DN} DN); what they show is lost; "
        f"lower mas (now {technique.protocol.mas:g}) or tube_kv"
    ]


def landmark_faults(truths: Iterable[Truth], technique: Technique) -> list[str]:
    """Describe labels of places that the image does not show; nothing if it shows all."""
    rows, cols = _lit(technique)
    beside = _BESIDE_AXIAL if technique.protocol.projection == "axial" else ()
    outside = [
        name
        for truth in truths
        for name, (row, col) in truth.landmarks_px.items()
        if not any(part in name for part in beside)
        and not (rows.start <= row + 0.5 < rows.stop and cols.start <= col + 0.5 < cols.stop)
    ]
    if not outside:
        return []
    named = ", ".join(outside[:_NAMED]) + (", ..." if len(outside) > _NAMED else "")
    where = "irradiated field" if is_collimated(technique.protocol) else "image"
    return [
        f"{len(outside)} landmarks are outside the {where} ({named}); their labels are of places that it does not "
        "show; enlarge the field or move the beam (centre_x_mm, centre_z_mm)"
    ]


def _lit(technique: Technique) -> tuple[slice, slice]:
    """Rows and columns of the detector within the collimated field, or all of them."""
    view = technique.view
    half_width, half_height = field_half_mm(technique)
    sides = []
    for count, half_mm in ((view.rows, half_height), (view.cols, half_width)):
        half = half_mm / view.pixel_mm
        sides.append(slice(max(0, int(np.floor(count / 2 - half))), min(count, int(np.ceil(count / 2 + half)))))
    return sides[0], sides[1]
