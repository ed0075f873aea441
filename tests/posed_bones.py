"""Build the bones of a knee in its posture, without soft tissue."""

from concurrent.futures import ThreadPoolExecutor

from pssf import Knee
from pssf.anatomy.bones import bone_shells
from pssf.anatomy.posture.knee_assembly import KneeAssembly
from pssf.anatomy.posture.placed_bones import place_bones


def build_posed_bones(knee: Knee, assembly: KneeAssembly) -> dict[str, bone_shells.Bone]:
    """Build the solids of each bone, by name."""
    with ThreadPoolExecutor(1) as background:
        placed = place_bones(knee, assembly, bone_shells.compute_cortex_depths_mm(assembly.bone_parameters), background)
    return {name: part.solids for name, part in placed.items()}
