"""explaining: which parameters of a knee leave its solids no room, where a check of solids fails."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..core.checks import InputError
from ..data.fields import FieldLaw, field_laws
from ..model.knee import Knee
from ..model.protocol import Posture

Laws = Mapping[str, FieldLaw]
# Fields that scale bones.
_SIZE = ("bone_scale", "stature_mm")
# Fault -> fields that bring it about.
_FIELDS = {
    "cortex": ("limb_ap_mm", "fat_mm", *_SIZE),
    "trabecular bone": ("cortex_scale", "subchondral_plate", "notch_growth_mm", *_SIZE),
    "marrow": ("cortex_scale", *_SIZE),
    "overlap": (
        *("jsw_medial_mm", "jsw_lateral_mm", "varus_deg", "subluxation_mm", "lean_deg", "tibial_slope_deg"),
        *("notch_growth_mm", "rotation_deg"),
    ),
}
# Bone -> fields of its own.
_OWN = {
    "patella": ("insall_salvati", "patellar_shift_mm", "patellar_tilt_deg"),
    "fibula": ("fibular_tip_mm",),
    "fabella": ("fabella_mm",),
}
# Nearer to the usual value, in half ranges, a field is not to blame; nor is a smaller osteophyte or score of a shape.
_LEAST_SHARE, _LEAST_MM, _LEAST_SD = 0.25, 2.0, 1.5
_MOST_NAMED = 5
_BENT_DEG = 20.0


class NoRoomError(InputError):
    """A solid leaves the one around it, or meets another; in words of the mesh, until `explaining` adds the knee's."""


@contextmanager
def explaining(knee: Knee, posture: Posture) -> Iterator[None]:
    """Turn a refusal of solids into one that names the parameters that conflict, with what is usual of each.

    Parameters
    ----------
    knee, posture
        What is built in this block, and how it is bent.

    Raises
    ------
    InputError
        A check of solids has failed. A refusal that names parameters already is raised as it is.
    """
    try:
        yield
    except InputError as error:
        text = str(error)
        if not isinstance(error, NoRoomError) and not text.startswith("solid "):
            raise
        raise InputError(_conflict(knee, posture, text, field_laws("knee"))) from None


def _conflict(knee: Knee, posture: Posture, text: str, laws: Laws) -> str:
    names = next((fields for fault, fields in _FIELDS.items() if fault in text), sum(_FIELDS.values(), ()))
    own = [name for bone, fields in _OWN.items() if bone in text for name in fields]
    usual = Knee(sex=knee.sex)
    departures = {name: _share(knee, usual, name, laws) for name in dict.fromkeys((*names, *own))}
    blamed = sorted((name for name, share in departures.items() if share >= _LEAST_SHARE), key=departures.__getitem__)
    said = [_said(knee, usual, name, laws[name].unit) for name in blamed[::-1][:_MOST_NAMED]] + _others(knee, posture)
    what = ", ".join(said) or "the parameters of this knee"
    return f"{what} must leave the solids room together, got {text}: bring one nearer to its usual value"


def _share(knee: Knee, usual: Knee, name: str, laws: Laws) -> float:
    """Return the distance of a value from the usual one, in half ranges of its field."""
    bounds = laws[name].range
    assert bounds is not None
    return abs(getattr(knee, name) - getattr(usual, name)) / (bounds[1] - bounds[0]) * 2


def _said(knee: Knee, usual: Knee, name: str, unit: str) -> str:
    value = f"{getattr(knee, name):.4g} {unit.replace('(relative)', '')}".strip()
    return f"{name} = {value} (usual {getattr(usual, name):.4g})"


def _others(knee: Knee, posture: Posture) -> list[str]:
    """Name other causes: large osteophytes, a shape far from the mean, a bent knee."""
    large = [f"{one.site} {one.size_mm:.3g} mm" for one in knee.osteophytes if one.size_mm >= _LEAST_MM]
    far: Any = np.flatnonzero(np.abs(knee.shape) >= _LEAST_SD) if knee.shape else ()
    bent = knee.flexion_deg + posture.flexion_deg
    return [
        *([f"osteophytes ({', '.join(large)})"] if large else []),
        *([f"shape (scores {', '.join(f'{knee.shape[n]:.3g}' for n in far)})"] if len(far) else []),
        *([f"flexion of {bent:.3g} deg in this posture"] if bent > _BENT_DEG else []),
    ]
