"""Check that every surface states the density of the material that surrounds it.

A surface subtracts its outside material from the path length at the density given by `outside_density`. If the material
around it has another density, the path length is wrong.
"""

from ..core.checks import InputError
from ..geometry.density import Density
from ..geometry.mesh_repair import Fault
from ..geometry.scene import Scene, Surface


def is_same_density(one: Density | None, other: Density | None) -> bool:
    """Compare two densities for identity or equality.

    Parameters
    ----------
    one, other : Density or None
        Relative densities to compare; None means the constant density of the material.

    Returns
    -------
    bool
        True if both are the same object, or compare equal. Densities that hold arrays are equal only if they are the
        same object.
    """
    if one is other:
        return True
    try:
        return one is not None and bool(one == other)
    except ValueError:  # Fields that hold arrays have no single truth value.
        return False


def find_density_faults(scene: Scene) -> list[Fault]:
    """Find surfaces whose `outside_density` matches no surrounding surface.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials and densities.

    Returns
    -------
    list of Fault
        One fault per surface for which no surface with that inside material has the stated density.

    Notes
    -----
    The path length in the outside material would be too short by the wrong integral. Example: a screw in trabecular
    bone that states no `outside_density` removes bone at full density.
    """
    return [
        _make_density_fault(surface, around)
        for surface in scene.surfaces
        if (around := _find_mismatched_surroundings(scene, surface))
    ]


def require_matching_densities(scene: Scene) -> None:
    """Raise an error if a surface states the wrong density of its surroundings.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials and densities.

    Raises
    ------
    InputError
        If `find_density_faults` finds a fault; the message names each surface and what to do.
    """
    faults = find_density_faults(scene)
    if faults:
        raise InputError("; ".join(map(str, faults)))


def _find_mismatched_surroundings(scene: Scene, surface: Surface) -> list[Surface]:
    """List the surfaces that may surround one, if all of them have another density than it states; else return none."""
    around = [one for one in scene.surfaces if one.inside == surface.outside and one is not surface]
    held = [one.inside_density for one in around] + [None] * (surface.outside == scene.ambient)
    return [] if any(is_same_density(density, surface.outside_density) for density in held) else around


def _make_density_fault(surface: Surface, around: list[Surface]) -> Fault:
    """Describe the density mismatch of one surface."""
    given = "None" if surface.outside_density is None else "another"
    names = " or ".join(one.name for one in around[:3]) + (" or others" if len(around) > 3 else "")
    return Fault(
        surface=surface.name,
        problem=f"outside_density must be that of the {surface.outside} around it (inside {names}), got {given}",
        count=0,
        first_items=(),
        outcome="refused",
        hint="pass that surface's inside_density, or insert the body with built.insert(mesh, material, name=)",
    )
