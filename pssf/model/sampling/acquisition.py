"""Sample acquisition variability: positioning and exposure technique, which differ between radiographs."""

from dataclasses import replace
from typing import Any

import numpy as np

from ...core.checks import (
    InputError,
    RNGLike,
    require_choice,
    resolve_generator,
)
from ...core.keyword_arguments import check_keywords
from ...data.imaging.acquisition_table import load_acquisition_variability
from ...data.knees.field_definitions import FieldSpec, load_field_specs
from ..knee import Knee
from ..protocol import Protocol

# Limit at which normal distributions are truncated, in standard deviations.
_TRUNCATION_SD = 2.0
# Rounding step of sampled values, in the unit of each field; smaller differences are not measurable.
_ROUNDING_STEP = 0.001
# Protocol fields that vary only if the protocol flexes the knee.
_FLEXION_FIELDS = ("flexion_deg", "tibia_forward_deg")
# Protocol fields that describe an acquisition, except the leg pose.
_ACQUISITION_FIELDS = (
    *("centre_x_mm", "centre_z_mm", "beam_angle_deg", "tibia_forward_deg", "tube_kv", "mas", "sdd_mm"),
    *("field_width_mm", "field_height_mm", "marker"),
)
# Letter of the side marker, keyed by the side of the body.
SIDE_MARKERS = {"right": "R", "left": "L"}


@check_keywords()
def sample_acquisition(protocol: Protocol, *, rng: RNGLike, side: str | None = None) -> Protocol:
    """Sample the acquisition variability of a protocol: positioning, beam, technique, field and marker.

    Centring, tilt, rotation and flexion of the leg, beam angle, distance, kV, mAs, field and marker are sampled from
    the distributions in ``data/exposures.toml``, which cites the sources. Sampled values are clipped to the allowed
    range of each field.

    Parameters
    ----------
    protocol : Protocol
        Protocol with nominal values.
    rng : int or numpy.random.Generator
        Seed or generator; the only source of randomness.
    side : {"right", "left"}, optional
        Side of the body that the side marker indicates. None: no marker.

    Returns
    -------
    Protocol
        Protocol with the sampled values; `Radiograph.protocol` stores it.

    Raises
    ------
    InputError
        If `protocol` is not a Protocol, `side` is unknown, or `rng` is neither an integer nor a Generator.

    Examples
    --------
    >>> import pssf
    >>> nominal = pssf.load_protocol("fixed_flexion")
    >>> varied = pssf.sample_acquisition(nominal, rng=7)
    >>> nominal.tube_kv, varied.tube_kv
    (70.0, 74.0)
    """
    if not isinstance(protocol, Protocol):
        raise InputError(f"protocol must be a Protocol, such as the result of load_protocol, got {protocol!r}")
    rng = resolve_generator(rng)
    require_choice("side", side, (*SIDE_MARKERS, None))
    table, laws = load_acquisition_variability(), load_field_specs("protocol")
    # All fields are sampled, including unused fields, so that the random numbers of a field do not depend on the use of
    # other fields.
    drawn = {name: float(_sample_normal(rng)) * sd for name, sd in (table.spread | table.factor).items()}
    width, height = (float(rng.uniform(*pair)) for pair in (table.field.width_mm, table.field.height_mm))
    marked = rng.random() < table.marker.share
    values = {name: getattr(protocol, name) + drawn[name] for name in table.spread}
    values |= {name: getattr(protocol, name) * float(np.exp(drawn[name])) for name in table.factor}
    if protocol.flexion_deg == 0:
        values |= {name: getattr(protocol, name) for name in _FLEXION_FIELDS}
    values["sod_mm"] = values["sdd_mm"] - (protocol.sdd_mm - protocol.sod_mm)
    within = {
        name: _clip_to_range(value, laws[name], table.step.get(name, _ROUNDING_STEP)) for name, value in values.items()
    }
    letter = SIDE_MARKERS[side] if marked and side is not None else "none"
    field: dict[str, Any] = {"field_width_mm": round(width, 1), "field_height_mm": round(height, 1), "marker": letter}
    if protocol.knee_distance_mm:  # The sampled field size is for one knee and too small for two.
        field |= {name: getattr(protocol, name) for name in ("field_width_mm", "field_height_mm")}
    return replace(protocol, **(field | within))


def describe_acquisition(knee: Knee, protocol: Protocol) -> dict[str, float | str]:
    """Return the values of all fields that `sample_acquisition` varies, for a knee imaged with a protocol.

    Parameters
    ----------
    knee : Knee
        Imaged knee, whose flexion, rotation and lean are included.
    protocol : Protocol
        Protocol of the radiograph.

    Returns
    -------
    dict of str to (float or str)
        Values keyed by protocol field. ``flexion_deg``, ``rotation_deg`` and ``tilt_deg`` are sums of the knee angle
        and the positioning angle of the protocol.
    """
    taken: dict[str, float | str] = {name: getattr(protocol, name) for name in _ACQUISITION_FIELDS}
    own = {"flexion_deg": knee.flexion_deg, "rotation_deg": knee.rotation_deg, "tilt_deg": knee.lean_deg}
    return taken | {name: round(getattr(protocol, name) + degrees, 4) for name, degrees in own.items()}


def _sample_normal(rng: np.random.Generator) -> float:
    """Sample a standard normal distribution truncated at two standard deviations."""
    while abs(value := rng.standard_normal()) > _TRUNCATION_SD:
        pass
    return float(value)


def _clip_to_range(value: float, law: FieldSpec, step: float) -> float:
    """Clip a field value to the allowed range of the field, and round it to a multiple of `step`."""
    assert law.range is not None
    return round(round(float(np.clip(value, *law.range)) / step) * step, 3)
