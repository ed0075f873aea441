"""Anybody's closed meshes: a water-filled leg with a bone and a titanium screw across it."""

from pathlib import Path

import trimesh

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the radiograph of a phantom and the path through its bone as PNG; `pixels` is the side of the detector."""
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
    part = (slice(pixels * 3 // 8, pixels * 5 // 8), slice(pixels // 4, pixels * 3 // 4))
    bone_mm = radiograph.kept["path_mm"]["cortical_bone"][part]
    shown = [
        make_panel(pssf.render_for_display(radiograph.pixels)[part], 320, 640, "radiograph"),
        make_panel(apply_heat_map(bone_mm, float(bone_mm.max())), 320, 640, "path through cortical bone"),
    ]
    return [write_image_row(shown, out / "own_meshes.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
