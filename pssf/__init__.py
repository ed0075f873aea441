"""Knee radiographs from physics, with labels that are true by construction, and the study they exist for.

core        checks of input, a timer, progress, work on many processes
data        the package's tables as typed, frozen records
model       knee, protocol, radiograph: what users construct and get back
geometry    views, scenes, densities, repair of meshes
anatomy     knee                 -> built knee: its scene and its labels
raycast     scene, protocol      -> path lengths; check(scene) -> what is wrong with it
xray        spectrum, materials, primary
scatter     kernel, Monte Carlo, grid
detector    blur, noise, panel, a view for eyes
stages      the chain, stage by stage
precompile  after an installation: kernels in two processes at once
image_faults  radiograph         -> what may not be as it was meant
simulation  knee, protocol       -> radiograph
io          files; the one package that writes to the disk
cohort      preset, seed         -> many radiographs and their manifest
radiomics   radiograph           -> region and features              (extra "study")
study       features             -> models, statistics, report       (extra "study")
experiment  a cohort, then its study
benchmark   a frozen data set, with splits and baselines      (extra "study")
quality     a protocol beside references
explore     a page with sliders in the browser                (extra "explore")
accuracy    error against run time
realism     knees beside people's bones and contours  (extra "study")
cli         the command line

A module imports from above it only. What users need is named in `__all__`, and loaded when it is first asked for.
"""

from __future__ import annotations

from importlib import import_module

# Not from `typing`: with `python -m pssf`, a file `typing.py` or `enum.py` of the working folder would be run for it.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from .anatomy import BuiltKnee, SurgeryNotice, build
    from .core.checks import InputError
    from .detector import present
    from .geometry.density import Density, PlaneWaves
    from .geometry.scene import MeshNotice, Scene, Surface
    from .image_faults import ImageNotice
    from .io.description import UnverifiedNotice
    from .io.images import load, load_parameters, save
    from .io.masks import load_masks, save_masks
    from .io.mesh_reader import read_mesh
    from .io.meshes import export_meshes
    from .io.scenes import read_scene
    from .model.draw import draw_knee, draw_pair
    from .model.exposure import draw_exposure
    from .model.knee import Cyst, Knee, Osteophyte
    from .model.look import draw_look
    from .model.progress import progress, true_change
    from .model.protocol import Protocol, load_protocol
    from .model.radiograph import Radiograph, Truth
    from .raycast import Paths, Report, check, trace
    from .simulation import KernelNotice, simulate
    from .study.own_images import features

    __version__: str

_WHERE = {
    "anatomy": ("BuiltKnee", "SurgeryNotice", "build"),
    "core.checks": ("InputError",),
    "detector": ("present",),
    "geometry.density": ("Density", "PlaneWaves"),
    "geometry.scene": ("MeshNotice", "Scene", "Surface"),
    "image_faults": ("ImageNotice",),
    "io.description": ("UnverifiedNotice",),
    "io.images": ("load", "load_parameters", "save"),
    "io.masks": ("load_masks", "save_masks"),
    "io.mesh_reader": ("read_mesh",),
    "io.meshes": ("export_meshes",),
    "io.scenes": ("read_scene",),
    "model.exposure": ("draw_exposure",),
    "model.look": ("draw_look",),
    "model.draw": ("draw_knee", "draw_pair"),
    "model.knee": ("Cyst", "Knee", "Osteophyte"),
    "model.progress": ("progress", "true_change"),
    "model.protocol": ("Protocol", "load_protocol"),
    "model.radiograph": ("Radiograph", "Truth"),
    "raycast": ("Paths", "Report", "check", "trace"),
    "simulation": ("KernelNotice", "simulate"),
    "study.own_images": ("features",),
}

__all__ = [
    "BuiltKnee",
    "Cyst",
    "Density",
    "ImageNotice",
    "InputError",
    "KernelNotice",
    "Knee",
    "MeshNotice",
    "Osteophyte",
    "Paths",
    "PlaneWaves",
    "Protocol",
    "Radiograph",
    "Report",
    "Scene",
    "Surface",
    "SurgeryNotice",
    "Truth",
    "UnverifiedNotice",
    "__version__",
    "build",
    "check",
    "draw_exposure",
    "draw_knee",
    "draw_look",
    "draw_pair",
    "export_meshes",
    "features",
    "load",
    "load_masks",
    "load_parameters",
    "load_protocol",
    "present",
    "progress",
    "read_mesh",
    "read_scene",
    "save",
    "save_masks",
    "simulate",
    "trace",
    "true_change",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version(__name__)
    for module, names in _WHERE.items():
        if name in names:
            value = getattr(import_module(f".{module}", __name__), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
