"""Error and run time of trabecular density integrals, and comparison of trabecular texture with patients."""

from dataclasses import replace
from time import process_time, thread_time

import numpy as np

from ...anatomy import build
from ...anatomy.trabeculae.trabecular_density import PIECE, build_healthy_tibia_trabeculae
from ...core.checks import Array
from ...core.processes.parallel_map import map_in_parallel
from ...data.analysis.reference_table import load_reference_tables
from ...data.anatomy.trabecular_table import load_trabecular_bone
from ...geometry.density import Density
from ...geometry.scene import Scene, Surface
from ...geometry.view import magnification, resolve_view
from ...model.knee import Knee
from ...model.protocol import Protocol, load_protocol
from ...model.sampling.knee_sampling import sample_knee
from ...radiomics.features.texture_measures import measure_texture
from ...raycast import ENGINES, trace_sparse
from ...simulation import simulate
from ..raycasting.raycast_engines import Row

# Edge length of the texture patch at the detector, in mm.
_PATCH_MM = 22.0
# Distance of the texture patch below the plateau, in mm in the joint plane.
_BELOW_MM = 6.0
# Position of the texture patch between the joint centre (0) and the middle of the medial compartment (1). At this
# position, the patch does not overlap the plateau edge.
_MEDIAL_FRACTION = 0.6


def measure_integration_steps() -> list[Row]:
    """Measure error and run time of the trabecular density integral for several step lengths.

    Ray segments of 40 mm cross the proximal tibia at the pixel spacing of the protocol ``reference``.

    Returns
    -------
    list of dict
        One row per leg rotation (``turned_deg``) and step (``step_mm``). ``seconds`` is the run time of one thread
        per million segments. ``rms`` and ``most`` are the root-mean-square and the largest relative error, compared
        with integrals from samples every 0.03 mm. ``texture`` is the RMS error divided by the standard deviation caused
        by the trabeculae.
    """
    table = load_trabecular_bone()
    bone = build_healthy_tibia_trabeculae(table, seed=1)
    even = replace(bone, density_parameters=bone.density_parameters._replace(gain=0.0, gain_shaft=0.0))
    step_mm = table.lattice.voxel_mm[2]
    x, z = (part.ravel() for part in np.meshgrid(np.arange(-35, 35, 0.124), np.arange(-1, -50, -1.0)))
    rows = []
    for turned_deg in (0.0, 5.0, 10.0):
        source = 950.0 * np.array([np.sin(np.deg2rad(turned_deg)), -np.cos(np.deg2rad(turned_deg)), 0.0])
        middles = np.column_stack((x, np.zeros_like(x), z))
        ways = (middles - source) * (20.0 / np.linalg.norm(middles - source, axis=1))[:, None]
        starts, ends = middles - ways, middles + ways
        exact = bone.integrate_with_steps(starts[::8], ends[::8], 16, 8)
        texture = (exact - even.integrate_with_steps(starts[::8], ends[::8], 16, 8)).std()
        bone.integrate(starts[:1], ends[:1])
        for fine in (1, 2, 4):
            start = thread_time()
            integrals = bone.integrate_with_steps(starts, ends, fine, PIECE)
            seconds = (thread_time() - start) / len(x) * 1e6
            error = integrals[::8] - exact
            far = np.abs(error / exact)
            rows.append({
                "turned_deg": turned_deg, "step_mm": step_mm / fine, "used": fine == 1, "seconds": round(seconds, 2),
                "rms": float(f"{np.sqrt(np.mean(far**2)):.2g}"), "most": float(f"{far.max():.2g}"),
                "texture": float(f"{np.sqrt(np.mean(error**2)) / texture:.2g}"),
            })  # fmt: skip
    return rows


def measure_texture_cost() -> list[Row]:
    """Measure the run time of the trabecular density integrals during ray casting of a knee, with one thread.

    Returns
    -------
    list of dict
        One row per engine, for the protocol ``reference``. ``samples`` is the number of density samples in millions,
        one voxel apart along the ray. ``ns`` is the time per sample in nanoseconds. ``seconds`` is the time of all
        integrals, fastest of three runs. ``time_fraction`` is the fraction of the ray-casting time.
    """
    protocol, built, rows = load_protocol("reference"), build(Knee()), list[Row]()
    per_mm = 1 / load_trabecular_bone().lattice.voxel_mm[2]
    for engine in ENGINES:
        runs = [_time_trace(built.scene, protocol, engine, per_mm) for _ in range(4)][1:]
        seconds, samples, whole = min(runs)
        rows.append({
            "engine": engine, "samples": round(samples / 1e6, 1), "ns": round(1e9 * seconds / samples, 1),
            "seconds": round(seconds, 3), "time_fraction": round(seconds / whole, 3),
        })  # fmt: skip
    return rows


def _time_trace(scene: Scene, protocol: Protocol, engine: str, per_mm: float) -> tuple[float, float, float]:
    """Time a ray trace; return seconds of the density integrals, number of samples, and seconds of the whole trace.

    `per_mm` is the number of samples per mm of path.
    """
    timed: dict[int, _TimedDensity] = {}

    def noted(density: Density | None) -> "_TimedDensity | None":
        # Surfaces with the same density need the same wrapper object, because ray casting compares object identities.
        return None if density is None else timed.setdefault(id(density), _TimedDensity(density, per_mm))

    surfaces = [
        Surface(
            one.mesh_arrays, one.inside, one.outside, one.name, noted(one.inside_density), noted(one.outside_density)
        )
        for one in scene.surfaces
    ]
    start = process_time()
    trace_sparse(Scene(surfaces, scene.ambient, scene.size_mm), protocol, engine=engine, workers=1)
    whole = process_time() - start
    return sum(one.seconds for one in timed.values()), sum(one.samples for one in timed.values()), whole


class _TimedDensity:
    """Density wrapper that records the run time and the number of samples of the integrals."""

    def __init__(self, density: Density, per_mm: float) -> None:
        self._density, self._per_mm = density, per_mm
        self.seconds = self.samples = 0.0

    def integrate(self, starts_mm: Array, ends_mm: Array) -> Array:
        """Integrate the density along straight segments.

        Parameters
        ----------
        starts_mm : (n, 3) array
            Start points in the knee frame, in mm.
        ends_mm : (n, 3) array
            End points in the knee frame, in mm.

        Returns
        -------
        (n,) array
            Integrals in mm.
        """
        start = thread_time()
        integrals = self._density.integrate(starts_mm, ends_mm)
        self.seconds += thread_time() - start
        self.samples += float(np.abs(ends_mm[:, 1] - starts_mm[:, 1]).sum()) * self._per_mm
        return integrals


def compare_texture_with_patients(count: int, workers: int) -> list[Row]:
    """Compare trabecular texture below the medial plateau with published values from patient radiographs.

    Parameters
    ----------
    count : int
        Number of sampled knees, all with KL grade 0, imaged with the protocol ``reference``.
    workers : int
        Number of worker processes.

    Returns
    -------
    list of dict
        One row per texture quantity: mean, 10th, 50th and 90th percentile of the simulated radiographs
        (``mean``, ``p10``, ``median``, ``p90``), and the published range (``real_low``, ``real_high``).
    """
    knees = [sample_knee(grade=0, rng=np.random.default_rng(k), grade_table="paper") for k in range(count)]
    textures = map_in_parallel(_measure_knee_texture, knees, shared={}, workers=workers)
    rows: list[Row] = []
    for name, known in load_reference_tables().texture.items():
        values = np.array([one[name] for one in textures])
        low, median, high = np.percentile(values, [10, 50, 90])
        low_real, high_real = known.range or ("", "")
        rows.append({
            "quantity": name, "mean": round(float(values.mean()), 3), "p10": round(float(low), 3),
            "median": round(float(median), 3), "p90": round(float(high), 3), "knees": count,
            "real_low": low_real, "real_high": high_real, "source": known.source,
        })  # fmt: skip
    return rows


def _measure_knee_texture(knee: Knee) -> dict[str, float]:
    """Simulate one knee and measure the texture of a patch below the medial plateau."""
    protocol = load_protocol("reference")
    radiograph = simulate(knee, protocol, rng=1, engine="scanline", workers=1)
    assert radiograph.truth is not None
    row, col = radiograph.truth.medial_joint_line_px
    col += (1 - _MEDIAL_FRACTION) * (radiograph.truth.landmarks_px["joint_centre"][1] - col)
    side = round(_PATCH_MM / protocol.pixel_mm)
    below = (knee.jsw_medial_mm / 2 + _BELOW_MM) * magnification(resolve_view(protocol)) / protocol.pixel_mm
    top, left = round(row + below), round(col - side / 2)
    return measure_texture(
        radiograph.pixels[top : top + side, left : left + side].astype(np.float64), protocol.pixel_mm
    )
