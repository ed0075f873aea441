"""Parameter conflicts: find the knee parameters that may have caused a failed check of a solid."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...core.checks import InputError
from ...data.knees.field_definitions import FieldSpec, load_field_specs
from ...model.knee import Knee
from ...model.protocol import Posture

# Specification of each field of a knee, by field name.
Laws = Mapping[str, FieldSpec]
# Fields that change the size of bones.
_SIZE_PARAMETERS = ("bone_scale", "stature_mm")
# Fields that may cause a check to fail, keyed by a word in the error message of the check.
_PARAMETERS_BY_FAULT = {
    "cortex": ("limb_ap_mm", "fat_mm", *_SIZE_PARAMETERS),
    "trabecular bone": ("cortex_scale", "subchondral_plate", "notch_growth_mm", *_SIZE_PARAMETERS),
    "marrow": ("cortex_scale", *_SIZE_PARAMETERS),
    "overlap": (
        *("jsw_medial_mm", "jsw_lateral_mm", "varus_deg", "subluxation_mm", "lean_deg", "tibial_slope_deg"),
        *("notch_growth_mm", "rotation_deg"),
    ),
}
# Fields that affect only one bone.
_PARAMETERS_BY_BONE = {
    "patella": ("insall_salvati", "patellar_shift_mm", "patellar_tilt_deg"),
    "fibula": ("fibular_tip_mm",),
    "fabella": ("fabella_mm",),
}
# An error message names a field only if the field differs from its usual value by at least this fraction of half its
# range.
_LEAST_SHARE = 0.25
# Smallest osteophyte size at which an error message names the osteophyte, in mm.
_LEAST_MM = 2.0
# Smallest magnitude of a shape score at which an error message names the score, in standard deviations.
_LEAST_SD = 1.5
# Largest number of fields in an error message.
_MAX_NAMED = 5
# Flexion above which an error message names the flexion, in degrees.
_MIN_FLEXION_DEG = 20.0


class SolidConflictError(InputError):
    """Error for a solid that extends beyond the solid around it or overlaps another solid.

    The error message names the solids; `explain_conflicts` adds the parameters of the knee.
    """


@contextmanager
def explain_conflicts(knee: Knee, posture: Posture) -> Iterator[None]:
    """Convert an error about solids into an error that names the conflicting parameters and their usual values.

    Parameters
    ----------
    knee : Knee
        Knee that is built inside the ``with`` block.
    posture : Posture
        Posture of the knee.

    Yields
    ------
    None
        Nothing; the ``with`` block runs.

    Raises
    ------
    InputError
        If a check of solids fails. An error that already names parameters is raised unchanged.
    """
    try:
        yield
    except InputError as error:
        text = str(error)
        if not isinstance(error, SolidConflictError) and not text.startswith("solid "):
            raise
        raise InputError(_format_conflict(knee, posture, text, load_field_specs("knee"))) from None


def _format_conflict(knee: Knee, posture: Posture, text: str, laws: Laws) -> str:
    """Return an error message that names the conflicting parameters and the failed check."""
    names = next(
        (fields for fault, fields in _PARAMETERS_BY_FAULT.items() if fault in text),
        sum(_PARAMETERS_BY_FAULT.values(), ()),
    )
    own = [name for bone, fields in _PARAMETERS_BY_BONE.items() if bone in text for name in fields]
    usual = Knee(sex=knee.sex)
    departures = {name: _compute_departure(knee, usual, name, laws) for name in dict.fromkeys((*names, *own))}
    blamed = sorted((name for name, share in departures.items() if share >= _LEAST_SHARE), key=departures.__getitem__)
    said = [
        _format_parameter(knee, usual, name, laws[name].unit) for name in blamed[::-1][:_MAX_NAMED]
    ] + _list_other_causes(knee, posture)
    what = ", ".join(said) or "the parameters of the knee"
    return f"{what} are incompatible: {text}; change one or more of these parameters towards their usual values"


def _compute_departure(knee: Knee, usual: Knee, name: str, laws: Laws) -> float:
    """Return the difference between the value of a field and its usual value, as a fraction of half its range."""
    bounds = laws[name].range
    assert bounds is not None
    return abs(getattr(knee, name) - getattr(usual, name)) / (bounds[1] - bounds[0]) * 2


def _format_parameter(knee: Knee, usual: Knee, name: str, unit: str) -> str:
    """Return a text with the name, the value and the usual value of a field."""
    value = f"{getattr(knee, name):.4g} {unit.replace('(relative)', '')}".strip()
    return f"{name} = {value} (usual {getattr(usual, name):.4g})"


def _list_other_causes(knee: Knee, posture: Posture) -> list[str]:
    """List other possible causes of a conflict: large osteophytes, extreme shape scores or a flexed knee."""
    large = [f"{one.site} {one.size_mm:.3g} mm" for one in knee.osteophytes if one.size_mm >= _LEAST_MM]
    far: Any = np.flatnonzero(np.abs(knee.shape) >= _LEAST_SD) if knee.shape else ()
    bent = knee.flexion_deg + posture.flexion_deg
    return [
        *([f"osteophytes ({', '.join(large)})"] if large else []),
        *([f"shape scores ({', '.join(f'{knee.shape[n]:.3g}' for n in far)})"] if len(far) else []),
        *([f"flexion of {bent:.3g} deg in this posture"] if bent > _MIN_FLEXION_DEG else []),
    ]
