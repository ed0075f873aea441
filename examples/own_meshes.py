"""Simulate a phantom from closed meshes: a leg of water, a bone, its canal, and a titanium screw across it."""

from pathlib import Path

import trimesh

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the radiograph and the path length in bone as one PNG; the detector has `pixels` x `pixels` pixels."""
    leg = trimesh.creation.cylinder(radius=50, height=240, sections=128)
    shaft = trimesh.creation.cylinder(radius=14, height=230, sections=96)
    canal = trimesh.creation.cylinder(radius=9, height=229, sections=96)
    screw = trimesh.creation.cylinder(radius=2, height=17, sections=48)
    screw.apply_transform(trimesh.transformations.rotation_matrix(1.2, [0, 1, 0]))
    scene = pssf.Scene(
        [
            pssf.Surface(leg, inside="water", outside="air", name="leg"),
            pssf.Surface(shaft, inside="cortical_bone", outside="water", name="shaft"),
            pssf.Surface(canal, inside="marrow", outside="cortical_bone", name="canal"),
            pssf.Surface(screw, inside="Ti@4.51", outside="marrow", name="screw"),
        ]
    )
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    print(pssf.check(scene, protocol))
    radiograph = pssf.simulate(scene, protocol, rng=1, keep=("path_mm",))
    window = (slice(pixels * 3 // 8, pixels * 5 // 8), slice(pixels // 4, pixels * 3 // 4))
    bone_mm = radiograph.kept["path_mm"]["cortical_bone"][window]
    longest_mm = float(bone_mm.max())
    panels = [
        make_panel(pssf.render_for_display(radiograph.pixels)[window], 320, 640, "radiograph"),
        make_panel(
            apply_heat_map(bone_mm, longest_mm), 320, 640, f"path length in cortical bone, 0 to {longest_mm:.0f} mm"
        ),
    ]
    return [write_image_row(panels, out / "own_meshes.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
