"""Build the bones of a knee in its posture, without soft tissue."""

from concurrent.futures import ThreadPoolExecutor

from pssf import Knee
from pssf.anatomy.bones import bone_shells
from pssf.anatomy.posture.knee_assembly import KneeAssembly
from pssf.anatomy.posture.placed_bones import build_bones, place_bones


def build_posed_bones(knee: Knee, assembly: KneeAssembly) -> dict[str, bone_shells.Bone]:
    """Build the solids of each bone, by name."""
    with ThreadPoolExecutor(1) as background:
        depths_mm = bone_shells.compute_cortex_depths_mm(assembly.bone_parameters)
        placed = place_bones(knee, assembly, build_bones(knee, assembly, depths_mm, background))
    return {name: part.solids for name, part in placed.items()}
