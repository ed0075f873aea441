"""Resolved technique: a protocol together with the detector, scatter kernel and tissues from the tables."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from ..core.checks import InputError
from ..data.anatomy.tissue_table import Tissue, load_tissues
from ..data.imaging.scatter_table import ScatterKernel, load_scatter_kernel
from ..geometry.view import View, resolve_view
from ..model.detector import Detector, resolve_detector
from ..model.protocol import Protocol
from .materials import Material, parse_compound, resolve_material


@dataclass(frozen=True, kw_only=True)
class Technique:
    """Protocol and tables that the imaging stages use.

    `resolve_technique` makes a Technique from a protocol once per radiograph; all stages receive it.

    Attributes
    ----------
    protocol : Protocol
        Technique, geometry and requested stages.
    detector : Detector
        Properties of the protocol's detector.
    kernel : ScatterKernel
        Constants of the scatter kernel.
    tissues : mapping of str to Tissue
        Tissues and metals that scenes may contain, by name.
    """

    protocol: Protocol
    detector: Detector
    kernel: ScatterKernel
    tissues: Mapping[str, Tissue] = field(hash=False, repr=False)

    @cached_property
    def view(self) -> View:
        """Source and detector plane of the protocol."""
        return resolve_view(self.protocol)

    def material(self, name: str) -> Material:
        """Look up a material by name.

        Parameters
        ----------
        name : str
            Tissue, metal, NIST compound, or formula with density.

        Returns
        -------
        Material
            Density and mass fractions of the elements.

        Raises
        ------
        InputError
            The material is unknown.
        """
        return resolve_material(name, self.tissues)

    def replace_protocol(self, **changes: Any) -> "Technique":
        """Make a copy in which some fields of the protocol have new values.

        Parameters
        ----------
        **changes
            New values by field name of `Protocol`. The detector cannot be changed.

        Returns
        -------
        Technique
            Copy with the changed protocol.

        Raises
        ------
        InputError
            A value is out of range, or `changes` contains another detector.
        """
        protocol = replace(self.protocol, **changes)
        if protocol.detector != self.protocol.detector:
            raise InputError(
                f"detector must be {self.protocol.detector!r}, got {protocol.detector!r}: "
                "call resolve_technique for another detector"
            )
        return replace(self, protocol=protocol)


def resolve_technique(protocol: Protocol) -> Technique:
    """Look up the detector, scatter kernel and tissues of a protocol.

    Parameters
    ----------
    protocol : Protocol
        Technique, geometry and requested stages.

    Returns
    -------
    Technique
        The protocol with its detector, scatter kernel and tissues.

    Raises
    ------
    InputError
        `protocol` is not a Protocol, or the material of a filter, scintillator or cover is unknown.
    """
    if not isinstance(protocol, Protocol):
        raise InputError(f"protocol must be a Protocol, for example from load_protocol, got {protocol!r}")
    detector, tissues = resolve_detector(protocol.detector), load_tissues()
    for name, _ in protocol.filters:
        resolve_material(name, tissues)
    for name in (f"{detector.formula}@{detector.density_g_per_cm3}", *(name for name, _ in detector.cover)):
        parse_compound(name)
    return Technique(
        protocol=protocol,
        detector=detector,
        kernel=load_scatter_kernel(),
        tissues=tissues,
    )
