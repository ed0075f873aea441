"""Knee radiographs from physics, with labels that are true by construction, and the study they exist for.

knee       Knee, Osteophyte, draw_knee                parameters of a knee, checked at birth
protocol   Protocol, load_protocol                    how it is taken
anatomy    build(knee)                 -> Scene       closed meshes between named materials
scene      Scene, Surface                             anybody's closed meshes
density    PlaneWaves                                 what varies within a material
raycast    check(scene)                -> Report      what is wrong with meshes, before any image is made
           trace(scene, protocol)      -> Paths       path length per material and pixel, audited
simulate   simulate(knee, protocol)    -> Radiograph  pixels and labels
files      save, load, load_parameters, save_masks,   the only part that touches the disk
           load_masks, export_meshes
cohort     plan and make a cohort of radiographs
radiomics  region and features                        (extra "study")
study      models, statistics, report                 (extra "study")
"""

from .anatomy import build
from .core.checks import InputError
from .exposure import present
from .geometry.density import PlaneWaves
from .geometry.scene import MeshNotice, Scene, Surface
from .io.images import load, load_parameters, save
from .io.masks import load_masks, save_masks
from .io.meshes import export_meshes
from .model.knee import Knee, Osteophyte, draw_knee
from .model.protocol import Protocol, load_protocol
from .model.radiograph import Radiograph, Truth
from .raycast import check, trace
from .simulate import simulate

__all__ = [
    "InputError",
    "Knee",
    "MeshNotice",
    "Osteophyte",
    "PlaneWaves",
    "Protocol",
    "Radiograph",
    "Scene",
    "Surface",
    "Truth",
    "build",
    "check",
    "draw_knee",
    "export_meshes",
    "load",
    "load_masks",
    "load_parameters",
    "load_protocol",
    "present",
    "save",
    "save_masks",
    "simulate",
    "trace",
]
