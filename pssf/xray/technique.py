"""Technique: a protocol with the records that its names stand for, resolved once and carried through the chain."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from ..core.checks import InputError
from ..data.detectors import Detector, detectors
from ..data.kernels import ScatterKernel, scatter_kernel
from ..data.tissues import Tissue, tissues
from ..geometry.view import View, view_of
from ..model.protocol import Protocol
from .materials import Material, material_of


@dataclass(frozen=True, kw_only=True)
class Technique:
    """What the stages of the chain read.

    protocol  how the radiograph is taken
    detector  that its `detector` names
    kernel    constants of the kernel of scatter
    tissues   name -> tissue, of those that materials may be named after
    """

    protocol: Protocol
    detector: Detector
    kernel: ScatterKernel
    tissues: Mapping[str, Tissue] = field(hash=False, repr=False)

    @cached_property
    def view(self) -> View:
        """Source and detector plane."""
        return view_of(self.protocol)

    def material(self, name: str) -> Material:
        """What a name in a scene stands for.

        raises  InputError for an unknown material
        """
        return material_of(name, self.tissues)

    def taken(self, **changes: Any) -> "Technique":
        """The same with other values in some fields of the protocol.

        raises  InputError for a value that is out of range, or another detector, whose record would be this one's
        """
        protocol = replace(self.protocol, **changes)
        if protocol.detector != self.protocol.detector:
            raise InputError(
                f"detector = {protocol.detector!r}; allowed: {self.protocol.detector!r}, as in technique_of"
            )
        return replace(self, protocol=protocol)


def technique_of(protocol: Protocol) -> Technique:
    """The door: a protocol's names become records.

    raises  InputError for what is no Protocol
    """
    if not isinstance(protocol, Protocol):
        raise InputError(f"protocol = {protocol!r}; allowed: a Protocol, as load_protocol gives it")
    return Technique(
        protocol=protocol, detector=detectors()[protocol.detector], kernel=scatter_kernel(), tissues=tissues()
    )
