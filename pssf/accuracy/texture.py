"""Trabeculae: error and cost of their integrals, and how they look on radiographs beside real films."""

from dataclasses import replace
from time import process_time, thread_time

import numpy as np

from ..anatomy import build
from ..anatomy.trabeculae import PIECE, healthy_tibia
from ..core.checks import Array
from ..core.parallel import ordered_map
from ..data.references import references
from ..data.spongy import trabecular_bone
from ..geometry.density import Density
from ..geometry.scene import Scene, Surface
from ..geometry.view import magnification, view_of
from ..model.draw import draw_knee
from ..model.knee import Knee
from ..model.protocol import Protocol, load_protocol
from ..radiomics.texture import texture
from ..raycast import ENGINES, trace_strips
from ..simulation import simulate
from .engines import Row

# Side of the patch at the detector, and how far below the joint line it begins, in the joint plane.
_PATCH_MM, _BELOW_MM = 22.0, 6.0
# Its middle is so far on the way from the joint's centre to the middle of the medial compartment: clear of the edge.
_MEDIAL = 0.6


def step_rows() -> list[Row]:
    """Error and time against the step: 40 mm through the upper tibia, for pixels of 0.15 mm of `reference`.

    turned_deg  how far the leg is turned about its long axis
    seconds     of one thread, for a million segments
    rms, most   error over the integral, root mean square and largest, against samples every 0.03 mm
    texture     RMS error over the standard deviation that struts give the integral
    """
    table = trabecular_bone()
    bone = healthy_tibia(table, seed=1)
    even = replace(bone, region=bone.region._replace(gain=0.0, gain_shaft=0.0))
    step_mm = table.lattice.voxel_mm[2]
    x, z = (part.ravel() for part in np.meshgrid(np.arange(-35, 35, 0.124), np.arange(-1, -50, -1.0)))
    rows = []
    for turned_deg in (0.0, 5.0, 10.0):
        source = 950.0 * np.array([np.sin(np.deg2rad(turned_deg)), -np.cos(np.deg2rad(turned_deg)), 0.0])
        middles = np.column_stack((x, np.zeros_like(x), z))
        ways = (middles - source) * (20.0 / np.linalg.norm(middles - source, axis=1))[:, None]
        starts, ends = middles - ways, middles + ways
        exact = bone.sampled(starts[::8], ends[::8], 16, 8)
        texture = (exact - even.sampled(starts[::8], ends[::8], 16, 8)).std()
        bone.integrate(starts[:1], ends[:1])
        for fine in (1, 2, 4):
            start = thread_time()
            integrals = bone.sampled(starts, ends, fine, PIECE)
            seconds = (thread_time() - start) / len(x) * 1e6
            error = integrals[::8] - exact
            far = np.abs(error / exact)
            rows.append({
                "turned_deg": turned_deg, "step_mm": step_mm / fine, "used": fine == 1, "seconds": round(seconds, 2),
                "rms": float(f"{np.sqrt(np.mean(far**2)):.2g}"), "most": float(f"{far.max():.2g}"),
                "texture": float(f"{np.sqrt(np.mean(error**2)) / texture:.2g}"),
            })  # fmt: skip
    return rows


def trace_rows() -> list[Row]:
    """One row an engine: what the integrals of density are of a textured trace of a knee under `reference`, one thread.

    samples   millions, a voxel's depth apart along the way through spongy bone
    ns        a sample
    seconds   of all integrals, best of three
    share     of the whole trace
    """
    protocol, built, rows = load_protocol("reference"), build(Knee()), list[Row]()
    per_mm = 1 / trabecular_bone().lattice.voxel_mm[2]
    for engine in ENGINES:
        runs = [_timed_trace(built.scene, protocol, engine, per_mm) for _ in range(4)][1:]
        seconds, samples, whole = min(runs)
        rows.append({
            "engine": engine, "samples": round(samples / 1e6, 1), "ns": round(1e9 * seconds / samples, 1),
            "seconds": round(seconds, 3), "share": round(seconds / whole, 3),
        })  # fmt: skip
    return rows


def _timed_trace(scene: Scene, protocol: Protocol, engine: str, per_mm: float) -> tuple[float, float, float]:
    """Seconds of the integrals of a trace, samples, of which there are so many in a mm, seconds of the whole."""
    timed: dict[int, _Timed] = {}

    def noted(density: Density | None) -> "_Timed | None":
        # What shares a density goes on sharing one.
        return None if density is None else timed.setdefault(id(density), _Timed(density, per_mm))

    surfaces = [
        Surface(one.arrays, one.inside, one.outside, one.name, noted(one.inside_density), noted(one.outside_density))
        for one in scene.surfaces
    ]
    start = process_time()
    trace_strips(Scene(surfaces, scene.ambient, scene.size_mm), protocol, engine=engine, workers=1)
    whole = process_time() - start
    return sum(one.seconds for one in timed.values()), sum(one.samples for one in timed.values()), whole


class _Timed:
    """A density that notes how long its integrals take."""

    def __init__(self, density: Density, per_mm: float) -> None:
        self._density, self._per_mm = density, per_mm
        self.seconds = self.samples = 0.0

    def integrate(self, starts_mm: Array, ends_mm: Array) -> Array:
        """(n,)  integral along straight segments, mm

        starts_mm, ends_mm  (n, 3)  knee frame
        """
        start = thread_time()
        integrals = self._density.integrate(starts_mm, ends_mm)
        self.seconds += thread_time() - start
        self.samples += float(np.abs(ends_mm[:, 1] - starts_mm[:, 1]).sum()) * self._per_mm
        return integrals


def spread_rows(count: int, workers: int) -> list[Row]:
    """One row a quantity: texture below the medial plateau on `reference` radiographs of grade 0, and of real films."""
    knees = [draw_knee(grade=0, rng=np.random.default_rng(k), grade_table="paper") for k in range(count)]
    textures = ordered_map(_texture_of, knees, shared={}, workers=workers)
    rows: list[Row] = []
    for name, known in references().texture.items():
        values = np.array([one[name] for one in textures])
        low, median, high = np.percentile(values, [10, 50, 90])
        low_real, high_real = known.range or ("", "")
        rows.append({
            "quantity": name, "mean": round(float(values.mean()), 3), "p10": round(float(low), 3),
            "median": round(float(median), 3), "p90": round(float(high), 3), "knees": count,
            "real_low": low_real, "real_high": high_real, "source": known.source,
        })  # fmt: skip
    return rows


def _texture_of(knee: Knee) -> dict[str, float]:
    protocol = load_protocol("reference")
    radiograph = simulate(knee, protocol, rng=1, engine="scanline", workers=1)
    assert radiograph.truth is not None
    row, col = radiograph.truth.medial_joint_line_px
    col += (1 - _MEDIAL) * (radiograph.truth.landmarks_px["joint_centre"][1] - col)
    side = round(_PATCH_MM / protocol.pixel_mm)
    below = (knee.jsw_medial_mm / 2 + _BELOW_MM) * magnification(view_of(protocol)) / protocol.pixel_mm
    top, left = round(row + below), round(col - side / 2)
    return texture(radiograph.pixels[top : top + side, left : left + side].astype(np.float64), protocol.pixel_mm)
