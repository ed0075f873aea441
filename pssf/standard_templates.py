"""Standard templates: noise-free radiographs of reference knees, used to localise joints on radiographs."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .core.processes.parallel_map import map_in_parallel
from .data.array_cache import Arrays, CacheKey, load_or_make_arrays
from .data.code_hash import list_pixel_data_files
from .model.knee import Knee, Osteophyte
from .model.protocol import Protocol, load_protocol
from .simulation import PIXEL_LIBRARIES, simulate

if TYPE_CHECKING:
    from .radiomics.localisation.templates import Template

# Knees of the localisation templates, keyed by protocol. The medial joint space ranges from healthy to narrower than in
# any grade of the grade table `paper`. Both protocols are needed, because the anterior and posterior plateau rims
# overlap with only one protocol.
_TEMPLATE_KNEES = {
    "reference": (Knee(jsw_medial_mm=5.0), Knee(jsw_medial_mm=3.5), Knee(jsw_medial_mm=2.0)),
    "fixed_flexion": (Knee(jsw_definition="read", jsw_medial_mm=4.5), Knee(jsw_definition="read", jsw_medial_mm=2.0)),
}
# Knee of the localisation template for severe osteoarthritis (KL 4): almost no medial joint space, osteophytes at all
# margins, varus deformity and a sclerotic subchondral bone plate.
_SEVERE_KNEE = Knee(
    jsw_definition="read",
    jsw_medial_mm=0.3,
    jsw_lateral_mm=5.5,
    flexion_deg=15.0,
    varus_deg=5.0,
    subchondral_plate=1.6,
    osteophytes=(
        Osteophyte(site="medial_tibia", size_mm=4.0),
        Osteophyte(site="medial_femur", size_mm=4.0),
        Osteophyte(site="lateral_tibia", size_mm=2.5),
        Osteophyte(site="lateral_femur", size_mm=2.5),
    ),
)
# Subpackages and modules that affect the pixels and labels of a template, in addition to the tables.
_CODE_PATHS = (
    *("anatomy", "core", "detector", "geometry", "model", "raycast", "scatter", "xray"),
    *("image_faults.py", "simulation.py", "stages.py", "standard_templates.py"),
)


def make_standard_templates(engine: str = "embree", *, workers: int = 1) -> "tuple[Template, ...]":
    """Make the templates for the localisation of joints on radiographs.

    The first template shows a standard knee. Additional templates show narrower medial joint spaces and a second
    projection, and the last template shows severe osteoarthritis. Templates have no noise and are scaled to the plateau
    width of the first template.

    Parameters
    ----------
    engine : {"embree", "scanline"}, default "embree"
        Ray casting engine.
    workers : int, default 1
        Number of processes. A single process uses two threads.

    Returns
    -------
    tuple of Template
        Templates; the standard knee is first.
    """
    from .radiomics.localisation.templates import Template  # This import requires the `learn` extra.

    protocols = {name: replace(load_protocol(name), noise="none") for name in _TEMPLATE_KNEES}
    cases = [(knee, protocols[name]) for name, knees in _TEMPLATE_KNEES.items() for knee in knees]
    cases.append((_SEVERE_KNEE, protocols["fixed_flexion"]))
    shared = {"engine": engine, "threads": 2 if workers == 1 else 1}

    def simulate_templates() -> Arrays:
        made = map_in_parallel(_simulate_template, cases, shared=shared, workers=workers)
        return {f"{name}_{number}": array for number, arrays in enumerate(made) for name, array in arrays.items()}

    # Templates depend on the package alone, and their simulation takes some 20 s.
    key = CacheKey(
        sources=(*_CODE_PATHS, *list_pixel_data_files()),
        libraries=PIXEL_LIBRARIES,
        facts=repr((engine, cases)).encode(),
    )
    arrays = load_or_make_arrays("localisation_templates", key, simulate_templates)
    first, *others = (
        Template(
            pixels=np.cumsum(arrays[f"steps_{number}"], axis=1, dtype=np.uint16),
            row=float(arrays[f"joint_px_{number}"][0]),
            col=float(arrays[f"joint_px_{number}"][1]),
            pixel_mm=protocol.pixel_mm,
            plateau_mm=float(arrays[f"plateau_mm_{number}"]),
            severe=knee is _SEVERE_KNEE,
        )
        for number, (knee, protocol) in enumerate(cases)
    )
    return (first, *(other.match_plateau_width(first) for other in others))


def _simulate_template(case: tuple[Knee, Protocol], engine: str, threads: int) -> dict[str, NDArray[Any]]:
    """Simulate a template: pixel differences, position of the joint line in pixels, and plateau width in mm."""
    knee, protocol = case
    radiograph = simulate(knee, protocol, engine=engine, workers=threads)
    assert radiograph.truth is not None
    edges = [radiograph.truth.landmarks_px[f"{side}_plateau_edge"][1] for side in ("medial", "lateral")]
    return {
        # Differences between neighbouring pixels, modulo 2**16, need half the disk space.
        "steps": np.diff(radiograph.pixels, axis=1, prepend=np.uint16(0)),
        "joint_px": np.array(radiograph.truth.medial_joint_line_px),
        "plateau_mm": np.array(abs(edges[0] - edges[1]) * protocol.pixel_mm),
    }
