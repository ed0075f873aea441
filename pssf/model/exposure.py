"""draw_exposure: a protocol as it is carried out, each time a little other."""

from dataclasses import replace
from typing import Any

import numpy as np

from ..core.checks import Chance, InputError, generator_of, require_choice
from ..core.keywords import keywords
from ..data.exposures import exposures
from ..data.fields import FieldLaw, field_laws
from .knee import Knee
from .protocol import Protocol

_CUT_SD = 2.0
# Digits that nobody could measure are left out.
_STEP = 0.001
# Only a protocol that bends the knee bends it more or less.
_OF_BENT = ("flexion_deg", "tibia_forward_deg")
# What is drawn, beside how the leg stands.
_TAKEN = (
    *("centre_x_mm", "centre_z_mm", "beam_angle_deg", "tibia_forward_deg", "tube_kv", "mas", "sdd_mm"),
    *("field_width_mm", "field_height_mm", "marker"),
)
# Letter of a side.
MARKERS = {"right": "R", "left": "L"}


@keywords()
def draw_exposure(protocol: Protocol, *, rng: Chance, side: str | None = None) -> Protocol:
    """Sample the acquisition variability of a protocol: positioning, beam, technique, field and marker.

    Centring, tilt, rotation and flexion of the leg, beam angle, distance, kV, mAs, field and marker vary by
    `data/exposures.toml`, which names its sources. A value that would leave its range is set to the range's end.

    Parameters
    ----------
    protocol : Protocol
        The view as it is meant.
    rng : int or numpy.random.Generator
        The only source of chance.
    side : {"right", "left"}, optional
        Side of the knee, whose letter the marker shows; without it there is no marker.

    Returns
    -------
    Protocol
        With all that was sampled; a radiograph keeps it.

    Raises
    ------
    InputError
        For anything but a Protocol, an unknown side, or an `rng` that is neither an integer nor a Generator.

    Examples
    --------
    >>> import pssf
    >>> varied = pssf.draw_exposure(pssf.load_protocol("fixed_flexion"), rng=7)
    >>> varied.name
    'fixed_flexion'
    """
    if not isinstance(protocol, Protocol):
        raise InputError(f"protocol = {protocol!r}; allowed: a Protocol, as load_protocol gives it")
    rng = generator_of(rng)
    require_choice("side", side, (*MARKERS, None))
    table, laws = exposures(), field_laws("protocol")
    # All are drawn, so that one more field of use leaves the others as they were.
    drawn = {name: float(_normal(rng)) * sd for name, sd in (table.spread | table.factor).items()}
    width, height = (float(rng.uniform(*pair)) for pair in (table.field.width_mm, table.field.height_mm))
    marked = rng.random() < table.marker.share
    values = {name: getattr(protocol, name) + drawn[name] for name in table.spread}
    values |= {name: getattr(protocol, name) * float(np.exp(drawn[name])) for name in table.factor}
    if protocol.flexion_deg == 0:
        values |= {name: getattr(protocol, name) for name in _OF_BENT}
    values["sod_mm"] = values["sdd_mm"] - (protocol.sdd_mm - protocol.sod_mm)
    within = {name: _within(value, laws[name], table.step.get(name, _STEP)) for name, value in values.items()}
    letter = MARKERS[side] if marked and side is not None else "none"
    field: dict[str, Any] = {"field_width_mm": round(width, 1), "field_height_mm": round(height, 1), "marker": letter}
    if protocol.apart_mm:  # what is drawn is the field of one knee
        field |= {name: getattr(protocol, name) for name in ("field_width_mm", "field_height_mm")}
    return replace(protocol, **(field | within))


def taking_of(knee: Knee, protocol: Protocol) -> dict[str, float | str]:
    """How a knee is taken under a protocol, by the names of its fields: all that `draw_exposure` varies.

    How the leg stands (flexion_deg, rotation_deg, tilt_deg) is the knee's own and the protocol's together.
    """
    taken: dict[str, float | str] = {name: getattr(protocol, name) for name in _TAKEN}
    own = {"flexion_deg": knee.flexion_deg, "rotation_deg": knee.rotation_deg, "tilt_deg": knee.lean_deg}
    return taken | {name: round(getattr(protocol, name) + degrees, 4) for name, degrees in own.items()}


def _normal(rng: np.random.Generator) -> float:
    while abs(value := rng.standard_normal()) > _CUT_SD:
        pass
    return float(value)


def _within(value: float, law: FieldLaw, step: float) -> float:
    """A field's value, in its range, in whole steps."""
    assert law.range is not None
    return round(round(float(np.clip(value, *law.range)) / step) * step, 3)
