"""Bones of a knee as it stands, without its soft tissue."""

from concurrent.futures import ThreadPoolExecutor

from pssf import Knee
from pssf.anatomy import bones
from pssf.anatomy.joint import KneeAssembly
from pssf.anatomy.placed_bones import place_bones


def standing_bones(knee: Knee, assembly: KneeAssembly) -> dict[str, bones.Bone]:
    """The solids of each bone, by name."""
    with ThreadPoolExecutor(1) as aside:
        placed = place_bones(knee, assembly, bones.shells_mm(assembly.build), aside)
    return {name: part.solids for name, part in placed.items()}
