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

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .anatomy import BuiltKnee, SurgeryNotice, build
    from .core.checks import InputError
    from .detector import present
    from .geometry.density import Density, PlaneWaves
    from .geometry.scene import MeshNotice, Scene, Surface
    from .io.images import load, load_parameters, save
    from .io.masks import load_masks, save_masks
    from .io.meshes import export_meshes, read_mesh
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

    __version__: str

_WHERE = {
    "anatomy": ("BuiltKnee", "SurgeryNotice", "build"),
    "core.checks": ("InputError",),
    "detector": ("present",),
    "geometry.density": ("Density", "PlaneWaves"),
    "geometry.scene": ("MeshNotice", "Scene", "Surface"),
    "io.images": ("load", "load_parameters", "save"),
    "io.masks": ("load_masks", "save_masks"),
    "io.meshes": ("export_meshes", "read_mesh"),
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
}

__all__ = [
    "BuiltKnee",
    "Cyst",
    "Density",
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
    "__version__",
    "build",
    "check",
    "draw_exposure",
    "draw_knee",
    "draw_look",
    "draw_pair",
    "export_meshes",
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
