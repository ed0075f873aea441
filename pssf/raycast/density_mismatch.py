"""Surfaces that do not name the density of what surrounds them: it would be taken away at another density."""

from ..core.checks import InputError
from ..geometry.density import Density
from ..geometry.repair import Fault
from ..geometry.scene import Scene, Surface


def is_same_density(one: Density | None, other: Density | None) -> bool:
    """Tell whether two densities are one: the same object, or equal ones."""
    if one is other:
        return True
    try:
        return one is not None and bool(one == other)
    except ValueError:  # arrays among their fields
        return False


def density_faults(scene: Scene) -> list[Fault]:
    """Describe surfaces whose `outside_density` no surface has inside that holds their outside material.

    The path in that material would be less by the wrong integral: where a screw in trabecular bone gives none, bone is
    taken away at full density.
    """
    return [_fault(surface, around) for surface in scene.surfaces if (around := _wrongly_around(scene, surface))]


def require_densities(scene: Scene) -> None:
    """Refuse a scene with such surfaces.

    Raises
    ------
    InputError
        Naming each surface and what to do.
    """
    faults = density_faults(scene)
    if faults:
        raise InputError("; ".join(map(str, faults)))


def _wrongly_around(scene: Scene, surface: Surface) -> list[Surface]:
    """Surfaces that may be around one, all with another density than it says; none if one has that."""
    around = [one for one in scene.surfaces if one.inside == surface.outside and one is not surface]
    held = [one.inside_density for one in around] + [None] * (surface.outside == scene.ambient)
    return [] if any(is_same_density(density, surface.outside_density) for density in held) else around


def _fault(surface: Surface, around: list[Surface]) -> Fault:
    given = "None" if surface.outside_density is None else "another"
    names = " or ".join(one.name for one in around[:3]) + (" or others" if len(around) > 3 else "")
    return Fault(
        surface=surface.name,
        what=f"outside_density must be that of the {surface.outside} around it (inside {names}), got {given}",
        count=0,
        first=(),
        outcome="refused",
        hint="pass that surface's inside_density, or place the body by built.insert(mesh, material, name=)",
    )
