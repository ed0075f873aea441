"""A titanium screw through muscle, cortical and trabecular bone: radiographs without and with it, and its paths."""

from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row

LENGTH_MM, PITCH_MM, CORE_MM, CREST_MM = 74.0, 2.75, 2.2, 1.1


def cancellous_screw() -> Manifold:
    """Give a screw along z with its head at z = 0: a turned eccentric disc makes core and thread."""
    disc = CrossSection.circle(CORE_MM + CREST_MM / 2, 48).translate((CREST_MM / 2, 0))
    threaded = 0.45 * LENGTH_MM
    thread = Manifold.extrude(disc, threaded, int(threaded * 8), 360 * threaded / PITCH_MM)
    shank = Manifold.cylinder(LENGTH_MM, CORE_MM, CORE_MM, 48)
    tip = Manifold.cylinder(4.0, CORE_MM, 0.3, 48).translate((0, 0, LENGTH_MM - 0.01))
    head = Manifold.sphere(4.2, 64).trim_by_plane((0, 0, 1), -2.0) - Manifold.cylinder(3.0, 1.8, 1.8, 6).translate(
        (0, 0, -3.0)
    )
    return thread.translate((0, 0, LENGTH_MM - threaded)) + shank + tip + head


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write both radiographs and the path through titanium as one PNG; `pixels` is the side of the detector."""
    built = pssf.build(pssf.Knee())
    # From the lateral side into the medial condyle.
    solid = cancellous_screw().rotate((0, 90, 8)).translate((-45, -2, 20)).to_mesh64()
    screw = trimesh.Trimesh(solid.vert_properties[:, :3], solid.tri_verts)
    fixed = built.insert(screw, "titanium_alloy", name="screw")
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    radiographs = [pssf.simulate(one, protocol, rng=1, keep=("path_mm",)) for one in (built, fixed)]
    before, after = (one.kept["path_mm"] for one in radiographs)
    metal = after["titanium_alloy"] > 0.1
    for tissue in ("muscle", "cortical_bone", "trabecular_bone"):
        lost_mm = (before[tissue] - after[tissue])[metal]
        print(f"{tissue}: the screw displaces {lost_mm.mean():.2f} mm on average, {lost_mm.max():.2f} mm at most")
    print("joint space", radiographs[1].truth.jsw_medial_mm, "mm, as without the screw; steps", fixed.surgery_table())
    part = np.s_[pixels * 3 // 10 : pixels * 6 // 10, pixels * 27 // 100 : pixels * 67 // 100]
    shown = [
        make_panel(pssf.render_for_display(one)[part], 360, 480, text)
        for one, text in zip(radiographs, ("before", "after"), strict=True)
    ]
    shown.append(make_panel(apply_heat_map(after["titanium_alloy"][part], 6.0), 360, 480, "titanium alloy, 0 to 6 mm"))
    return [write_image_row(shown, out / "screw.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
