"""texture_of, make_texture: the trabecular density of a knee's bones, from its parameters."""

from ..core.checks import Array
from ..data.anatomy import anatomy_tables
from ..data.spongy import TrabecularBone
from ..model.knee import Knee
from .joint import KneeAssembly
from .trabeculae import Trabeculae, make_struts, trabeculae


def make_texture(knee: Knee) -> None:
    """Make the struts of a knee's bones, which its rays alone need: in a thread of its own, while it is built."""
    make_struts(
        anatomy_tables().spongy,
        seed=knee.texture_seed,
        sclerosis=knee.subchondral_plate,
        age_years=knee.age_years,
        sex=knee.sex,
    )


def texture_of(knee: Knee, bone: str, table: TrabecularBone, assembly: KneeAssembly, frame: Array) -> Trabeculae:
    """Give the density of one bone of a knee.

    Parameters
    ----------
    frame : (3, 4) array, mm
        Transform from the frame of its trabeculae to that of a right knee as it stands.
    """
    return trabeculae(
        bone,
        table,
        seed=knee.texture_seed,
        scale=assembly.build.scale,
        frame=frame if assembly.turn is None else assembly.turn @ frame,
        mirror=assembly.mirror,
        sclerosis=knee.subchondral_plate,
        age_years=knee.age_years,
        sex=knee.sex,
        density=knee.bone_density,
        sclerotic_side=knee.sclerotic_side,
    )
