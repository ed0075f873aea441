"""Simulate knee radiographs from physics with true labels, and run a radiomics study on them.

core        input checks, timing, progress display, parallel execution
data        tables of the package as typed, frozen records
model       input and output types: knee, protocol, radiograph, truth; sampling of knees and acquisitions
geometry    views, scenes, densities, mesh repair
anatomy     knee                 -> built knee: its scene and its labels
raycast     scene, protocol      -> path lengths; check(scene) -> faults of the scene
xray        spectrum, materials, primary beam
scatter     scatter kernel, Monte Carlo simulation, anti-scatter grid
detector    blur, noise, readout, display processing
stages      stages of the imaging chain, from path lengths to pixels
image_faults  radiograph         -> warnings about unintended properties of a radiograph
simulation  knee, protocol       -> radiograph
io          reading and writing of files; no other subpackage writes files
cohort      preset, seed         -> radiographs and their manifest
dataset     settings             -> labelled images for the training of networks
reader      image                -> landmarks, joint space and bone masks     (extra "reader")
reader_training  data set        -> networks of the reader                    (extra "train")
torch       data sets of PyTorch                                     (extra "torch")
texture     fractal signature and other measures of trabecular bone, and their regions
radiomics   radiograph           -> region and features              (extra "study")
study       features             -> models, statistics, report       (extra "study")
standard_templates  radiographs of reference knees, with which joints are localised  (extra "study")
experiment  run of a cohort and its study
trial       virtual trial            -> errors of the joint space, and subjects per arm  (extra "study")
benchmark   frozen data set with splits and baselines                (extra "study")
quality     image quality of a protocol, compared with reference values
calibration  images of a detector  -> detector and protocol with intervals
explore     interactive page in the browser                          (extra "explore")
validation  numerical error and run time
patient_comparison  comparison with bones, landmarks and radiographs of patients  (extra "study")
cli         command line

A subpackage imports only from subpackages above it in this list. Public names are in `__all__`, and are loaded on first
use.
"""

from __future__ import annotations

from importlib import import_module

# TYPE_CHECKING is not imported, because `python -m pssf` would run a file `typing.py` of the working folder.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from .anatomy import BuiltKnee, SurgeryNotice, build
    from .core.checks import InputError
    from .detector import render_for_display
    from .geometry.density import Density, PlaneWaves
    from .geometry.scene import MeshNotice, Scene, Surface
    from .image_faults import ImageNotice
    from .io.mask_files import load_masks, save_masks
    from .io.meshes.mesh_export import export_meshes
    from .io.meshes.mesh_reader import read_mesh
    from .io.meshes.scene_file import read_scene
    from .io.metadata import UnverifiedNotice
    from .io.radiograph_files import load, load_parameters, save
    from .model.detector import Detector, load_detector
    from .model.knee import Cyst, Knee, Osteophyte
    from .model.progression import progress, true_change
    from .model.protocol import Protocol, load_protocol
    from .model.radiograph import Radiograph, Truth
    from .model.sampling.acquisition import sample_acquisition
    from .model.sampling.display_sampling import sample_display_processing
    from .model.sampling.knee_sampling import sample_knee, sample_knee_pair
    from .raycast import (
        Paths,
        Report,
        check,
        trace,
    )
    from .reader.film_reading import FilmReading, read
    from .reader.knee_reading import KneeReading
    from .simulation import KernelNotice, simulate
    from .study.prediction.own_images import features

    __version__: str

# Subpackages with public names of their own, which are loaded on first use.
_SUBPACKAGES = ("dataset", "texture")
_WHERE = {
    "anatomy": ("BuiltKnee", "SurgeryNotice", "build"),
    "core.checks": ("InputError",),
    "detector": ("render_for_display",),
    "geometry.density": ("Density", "PlaneWaves"),
    "geometry.scene": ("MeshNotice", "Scene", "Surface"),
    "image_faults": ("ImageNotice",),
    "io.metadata": ("UnverifiedNotice",),
    "io.radiograph_files": ("load", "load_parameters", "save"),
    "io.mask_files": ("load_masks", "save_masks"),
    "io.meshes.mesh_reader": ("read_mesh",),
    "io.meshes.mesh_export": ("export_meshes",),
    "io.meshes.scene_file": ("read_scene",),
    "model.sampling.acquisition": ("sample_acquisition",),
    "model.sampling.display_sampling": ("sample_display_processing",),
    "model.sampling.knee_sampling": ("sample_knee", "sample_knee_pair"),
    "model.knee": ("Cyst", "Knee", "Osteophyte"),
    "model.progression": ("progress", "true_change"),
    "model.detector": ("Detector", "load_detector"),
    "model.protocol": ("Protocol", "load_protocol"),
    "model.radiograph": ("Radiograph", "Truth"),
    "raycast": ("Paths", "Report", "check", "trace"),
    "reader.film_reading": ("FilmReading", "read"),
    "reader.knee_reading": ("KneeReading",),
    "simulation": ("KernelNotice", "simulate"),
    "study.prediction.own_images": ("features",),
}

__all__ = [
    "BuiltKnee",
    "Cyst",
    "Density",
    "Detector",
    "FilmReading",
    "ImageNotice",
    "InputError",
    "KernelNotice",
    "Knee",
    "KneeReading",
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
    "export_meshes",
    "features",
    "load",
    "load_detector",
    "load_masks",
    "load_parameters",
    "load_protocol",
    "progress",
    "read",
    "read_mesh",
    "read_scene",
    "render_for_display",
    "sample_acquisition",
    "sample_display_processing",
    "sample_knee",
    "sample_knee_pair",
    "save",
    "save_masks",
    "simulate",
    "trace",
    "true_change",
]


# Current names, keyed by earlier name.
_RENAMED = {
    "draw_exposure": "sample_acquisition",
    "draw_knee": "sample_knee",
    "draw_look": "sample_display_processing",
    "draw_pair": "sample_knee_pair",
    "present": "render_for_display",
}


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        message = f"pssf.{name} is now pssf.{_RENAMED[name]}; the earlier name will be removed"
        import_module("warnings").warn(message, DeprecationWarning, stacklevel=2)
        return __getattr__(_RENAMED[name])
    if name == "__version__":
        return import_module("importlib.metadata").version(__name__)
    if name in _SUBPACKAGES:
        return import_module(f".{name}", __name__)
    for module, names in _WHERE.items():
        if name in names:
            value = getattr(import_module(f".{module}", __name__), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
