"""Insert a titanium screw into a built knee, across muscle, cortical and trabecular bone."""

from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row

LENGTH_MM, PITCH_MM, CORE_MM, CREST_MM = 74.0, 2.75, 2.2, 1.1


def make_cancellous_screw() -> Manifold:
    """Make a screw along z, with its head at z = 0; a twisted extrusion of an eccentric disc gives core and thread."""
    disc = CrossSection.circle(CORE_MM + CREST_MM / 2, 48).translate((CREST_MM / 2, 0))
    threaded_mm = 0.45 * LENGTH_MM
    thread = Manifold.extrude(disc, threaded_mm, int(threaded_mm * 8), 360 * threaded_mm / PITCH_MM)
    shank = Manifold.cylinder(LENGTH_MM, CORE_MM, CORE_MM, 48)
    tip = Manifold.cylinder(4.0, CORE_MM, 0.3, 48).translate((0, 0, LENGTH_MM - 0.01))
    head = Manifold.sphere(4.2, 64).trim_by_plane((0, 0, 1), -2.0) - Manifold.cylinder(3.0, 1.8, 1.8, 6).translate(
        (0, 0, -3.0)
    )
    return thread.translate((0, 0, LENGTH_MM - threaded_mm)) + shank + tip + head


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write two radiographs and the path length in titanium as PNG; the detector has `pixels` x `pixels` pixels."""
    built = pssf.build(pssf.Knee())
    # The screw runs from the lateral side into the medial condyle.
    solid = make_cancellous_screw().rotate((0, 90, 8)).translate((-45, -2, 20)).to_mesh64()
    screw = trimesh.Trimesh(solid.vert_properties[:, :3], solid.tri_verts)
    with_screw = built.insert(screw, "titanium_alloy", name="screw")
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    radiographs = [pssf.simulate(knee, protocol, rng=1, keep=("path_mm",)) for knee in (built, with_screw)]
    before, after = (radiograph.kept["path_mm"] for radiograph in radiographs)
    metal = after["titanium_alloy"] > 0.1
    for tissue in ("muscle", "cortical_bone", "trabecular_bone"):
        displaced_mm = (before[tissue] - after[tissue])[metal]
        print(f"{tissue}: displaced {displaced_mm.mean():.2f} mm on average, {displaced_mm.max():.2f} mm at most")
    jsw_mm = [radiograph.truth.jsw_medial_mm for radiograph in radiographs]
    print(f"medial joint space {jsw_mm[0]:.2f} mm before and {jsw_mm[1]:.2f} mm after")
    for step in with_screw.surgery_table():
        print(f"{step['step']} {step['name']}: {step['material']}")
    window = np.s_[pixels * 3 // 10 : pixels * 6 // 10, pixels * 27 // 100 : pixels * 67 // 100]
    panels = [
        make_panel(pssf.render_for_display(radiograph)[window], 360, 480, caption)
        for radiograph, caption in zip(radiographs, ("before", "after"), strict=True)
    ]
    panels.append(
        make_panel(apply_heat_map(after["titanium_alloy"][window], 6.0), 360, 480, "titanium alloy, 0 to 6 mm")
    )
    return [write_image_row(panels, out / "screw.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
