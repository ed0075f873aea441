"""Check that the `outside_density` of every surface is the density of the surrounding material.

Inside a surface, `trace` subtracts the path in the outside material, weighted by `outside_density`. If the surrounding
material has another density, the path length is wrong.
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
        True if both are the same object, or compare equal. Densities with array fields are equal only if they are the
        same object.
    """
    if one is other:
        return True
    try:
        return one is not None and bool(one == other)
    except ValueError:  # Comparison of array fields returns an array instead of one truth value.
        return False


def find_density_faults(scene: Scene) -> list[Fault]:
    """Find surfaces whose `outside_density` is not the inside density of any surrounding surface.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials and densities.

    Returns
    -------
    list of Fault
        One fault per surface whose outside material is inside other surfaces, but never with the specified
        `outside_density`.

    Notes
    -----
    A wrong `outside_density` removes the wrong amount of the outside material. For example, a screw in trabecular bone
    without an `outside_density` removes bone at full density. The path in bone is then too short.
    """
    return [
        _make_density_fault(surface, around)
        for surface in scene.surfaces
        if (around := _find_mismatched_surroundings(scene, surface))
    ]


def require_matching_densities(scene: Scene) -> None:
    """Raise an error if the `outside_density` of a surface is not the density of the surrounding material.

    Parameters
    ----------
    scene : Scene
        Closed surfaces with their materials and densities.

    Raises
    ------
    InputError
        If `find_density_faults` finds a fault. The message reports each surface with a remedy.
    """
    faults = find_density_faults(scene)
    if faults:
        raise InputError("; ".join(map(str, faults)))


def _find_mismatched_surroundings(scene: Scene, surface: Surface) -> list[Surface]:
    """List the possible surroundings of a surface; return an empty list if one of them has its `outside_density`."""
    around = [one for one in scene.surfaces if one.inside == surface.outside and one is not surface]
    held = [one.inside_density for one in around] + [None] * (surface.outside == scene.ambient)
    return [] if any(is_same_density(density, surface.outside_density) for density in held) else around


def _make_density_fault(surface: Surface, around: list[Surface]) -> Fault:
    """Describe the density mismatch of one surface."""
    given = "None" if surface.outside_density is None else "another"
    names = " or ".join(one.name for one in around[:3]) + (" or others" if len(around) > 3 else "")
    return Fault(
        surface=surface.name,
        problem=f"outside_density must be the density of the {surface.outside} around it (inside {names}), got {given}",
        count=0,
        first_items=(),
        outcome="error",
        hint=(
            "pass the inside_density of the surrounding surface, or insert the body with "
            "built.insert(mesh, material, name=)"
        ),
    )
