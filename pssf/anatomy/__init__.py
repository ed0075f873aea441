"""anatomy.build  knee parameters -> BuiltKnee: the knee, its scene of closed meshes, its labels

built        the object that carries them                       joint        the pose that gives the joint spaces
bones        femur, tibia, fibula, patella as nested solids     osteophytes  lips and spikes that flow into the bone
lips         along a joint's margins                            spikes       on spines, and within joint surfaces
femur, tibia their outer shapes, blended                        mean_bone    their solids at the mean man's size
implicit     fields, blends, settling onto them                 remesh       smoothed, refined, without folds
shape        lattices that give bones people's form
plateau      its margins, and a beam along it               turned_truth labels from the side and along the leg
pair         both knees of a person in one scene            bend         soft tissue about a bent knee
soft         skin, subcutaneous fat, fascia                     muscles      muscles, and the fat between them
envelope     what provably holds a bone, coarsely               tendons      of patella and quadriceps; the fat pad
cartilage    cartilage and menisci                              tissues      all of these, carved clear of each other
trabeculae   density of the trabecular bone                      solids       lofts, hulls, height fields, checks
texture      that density, of a knee's parameters
wear         a plateau worn by the femur                        attrition    how deep that is
contours     projected outlines and the gap between them        truth        labels and landmarks
landmarks    sixteen places on the contours, as on people's films
placed_bones bones as solids, where they stand in the leg
surgery      implants and resections                        surgery_truth labels that are still true after them
uncut_faces  of a mesh, away from a cut, as they were
ship         the mean bones as solids, put into the package
"""

from .built import BuiltKnee, build
from .pair import BuiltPair, build_pair
from .surgery_truth import SurgeryNotice
from .texture import make_texture
from .trabeculae import BONES

__all__ = ["BONES", "BuiltKnee", "BuiltPair", "SurgeryNotice", "build", "build_pair", "make_texture"]
