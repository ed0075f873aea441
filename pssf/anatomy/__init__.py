"""Anatomy: build a knee from its parameters as closed surfaces, with its labels.

- `built_knee`: `BuiltKnee`, a knee with its surfaces and labels, and `build`, which makes it.
- `last_knee`: parts of the last built knee that are kept for another posture.
- `knee_pair`: both knees of a patient in one scene.
- `bones`: osteophytes, bone shells and wear of the plateau.
- `template`: template bones, and how size, shape and alignment of a knee change them.
- `meshing`: implicit shapes, lofts, remeshing and other operations on solids.
- `posture`: pose of the bones, solved for the specified JSW.
- `soft_tissue`: skin, fat, muscles, tendons, cartilage and menisci.
- `trabeculae`: density of the trabecular bone.
- `knee_trabeculae`: trabecular density computed from the parameters of a knee.
- `subchondral_cysts`: cysts below the subchondral bone plate.
- `surgery`: implants and resections.
- `outlines`: projected contours and the landmarks on them.
- `labels`: labels of radiographs, also after surgery.
"""

from .built_knee import BuiltKnee, build
from .knee_pair import BuiltPair, build_pair
from .knee_trabeculae import make_texture
from .labels.surgery_labels import SurgeryNotice
from .trabeculae.trabecular_density import BONES

__all__ = ["BONES", "BuiltKnee", "BuiltPair", "SurgeryNotice", "build", "build_pair", "make_texture"]
