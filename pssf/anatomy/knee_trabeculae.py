"""Trabecular density of the bones of a knee, computed from its parameters."""

from ..core.checks import Array
from ..data.anatomy.anatomy_tables import load_anatomy_tables
from ..data.anatomy.trabecular_table import TrabecularBone
from ..model.knee import Knee
from .posture.knee_assembly import KneeAssembly
from .trabeculae.trabecular_density import Trabeculae, build_trabeculae, make_struts


def make_texture(knee: Knee) -> None:
    """Compute the trabecular struts of a knee and cache them for ray casting.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.

    Notes
    -----
    Only ray casting needs the struts, so a separate thread can compute them while the knee is built.
    """
    make_struts(
        load_anatomy_tables().trabecular_bone,
        seed=knee.texture_seed,
        sclerosis=knee.subchondral_plate,
        age_years=knee.age_years,
        sex=knee.sex,
    )


def build_bone_texture(
    knee: Knee, bone: str, table: TrabecularBone, assembly: KneeAssembly, frame: Array
) -> Trabeculae:
    """Build the trabecular density of one bone of a knee.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    bone : str
        Name of the bone.
    table : TrabecularBone
        Volume fractions and strut lattice of trabecular bone.
    assembly : KneeAssembly
        Bones of the knee in their pose.
    frame : (3, 4) float64 array, mm
        Transform from the frame of the bone to the frame of the leg.

    Returns
    -------
    Trabeculae
        Density in the knee frame.
    """
    return build_trabeculae(
        bone,
        table,
        seed=knee.texture_seed,
        scale=assembly.bone_parameters.scale,
        frame=frame if assembly.view_rotation is None else assembly.view_rotation @ frame,
        mirror=assembly.mirror,
        sclerosis=knee.subchondral_plate,
        age_years=knee.age_years,
        sex=knee.sex,
        density=knee.bone_density,
        sclerotic_side=knee.sclerotic_side,
    )
