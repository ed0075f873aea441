"""Last built knee of a thread: its parts that do not depend on the posture are kept for the next build."""

import threading
from dataclasses import dataclass

from ..data.anatomy.anatomy_tables import AnatomyTables
from ..model.knee import Knee
from .bones import bone_shells
from .posture.knee_assembly import GrownBones, KneeAssembly
from .posture.placed_bones import UnplacedBones
from .soft_tissue.cartilage_and_menisci import CartilageLayer
from .soft_tissue.joint_tissues import CoveredBone, build_cartilage, cover_bones
from .template.bone_builder import BoneParameters, resolve_bone_parameters

# Parts of the last knee that each thread has built, so that another posture of this knee takes less time.
_LAST = threading.local()


@dataclass
class LastKnee:
    """Parts of a knee that do not depend on its posture; None if they are not built yet.

    Attributes
    ----------
    knee : Knee
        Parameters of the knee.
    tables : AnatomyTables
        Tables that determine the bones of `knee`.
    bone_parameters : BoneParameters
        Parameters of the bones.
    grown : GrownBones or None
        Femur and tibia with osteophytes.
    unplaced : UnplacedBones or None
        Solids of all bones, each in its own frame.
    cartilage : tuple of CartilageLayer or None
        Cartilage layers of femur and tibia.
    """

    knee: Knee
    tables: AnatomyTables
    bone_parameters: BoneParameters
    grown: GrownBones | None = None
    unplaced: UnplacedBones | None = None
    cartilage: tuple[CartilageLayer, CartilageLayer] | None = None

    def cover_bones(self, assembly: KneeAssembly) -> tuple[CoveredBone, CoveredBone]:
        """Cover femur and tibia with their cartilage in a posture.

        Parameters
        ----------
        assembly : KneeAssembly
            Bones of this knee and their pose.

        Returns
        -------
        tuple of CoveredBone
            Femur and tibia.
        """
        if self.cartilage is None:
            assert self.grown is not None
            self.cartilage = build_cartilage(self.knee, self.grown)
        return cover_bones(self.cartilage, assembly)


def recall_last_knee(knee: Knee, tables: AnatomyTables) -> LastKnee:
    """Return the parts of a knee if this thread built the same knee last; otherwise return new, empty parts.

    Parameters
    ----------
    knee : Knee
        Parameters of the knee.
    tables : AnatomyTables
        Tables of the anatomy.

    Returns
    -------
    LastKnee
        Parts of the knee.
    """
    last: LastKnee | None = getattr(_LAST, "knee", None)
    if last is None or last.knee != knee or last.tables is not tables:
        bone_parameters = resolve_bone_parameters(knee, tables)
        bone_shells.prepare_template_bones(bone_parameters)
        last = _LAST.knee = LastKnee(knee, tables, bone_parameters)
    return last
