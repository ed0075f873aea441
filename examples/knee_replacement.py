"""Replace a knee joint: femoral component, tibial tray and polyethylene bearing, shaped to the resected bones."""

import warnings
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold, Mesh64

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row

# Profile of the femur after resection, from anterior to posterior: y and z of its corners, in mm.
FEMORAL_PROFILE_MM = [(-24, 99), (-24, 24), (-15, 12), (14, 12), (22, 20), (22, 99)]
# Height of the tibial cut, thickness of the tray, and height of the anterior flange, in mm.
TIBIAL_CUT_MM, TRAY_MM, FLANGE_MM = -9.0, 4.0, 46.0


def to_solid(built: pssf.BuiltKnee, name: str) -> Manifold:
    """Convert a surface of a built knee to a solid."""
    mesh = next(surface.mesh_arrays for surface in built.scene.surfaces if surface.name == name)
    return Manifold(Mesh64(np.ascontiguousarray(mesh.vertices), mesh.faces.astype(np.uint64)))


def to_mesh(solid: Manifold) -> trimesh.Trimesh:
    """Convert a solid to a mesh."""
    mesh = solid.to_mesh64()
    return trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts)


def make_components(built: pssf.BuiltKnee) -> tuple[Manifold, Manifold, Manifold, Manifold]:
    """Make the resected tibial bone, the femoral component, the tray with its stem, and the bearing."""
    femur = to_solid(built, "femur") + to_solid(built, "femur_cartilage")
    profile = CrossSection([FEMORAL_PROFILE_MM])
    core = Manifold.extrude(profile, 200).rotate((90, 0, 90)).translate((-100, 0, 0))
    femoral = (femur - core).trim_by_plane((0, 0, -1), -FLANGE_MM)
    femoral = (femoral ^ Manifold.cube((72, 200, 200), True)).decompose()
    femoral = max(femoral, key=lambda piece: piece.volume())
    plateau = to_solid(built, "tibia").slice(TIBIAL_CUT_MM)
    bone = Manifold.cube((110, 110, 24), True).translate((0, 0, TIBIAL_CUT_MM + 12)) - femur - femoral
    tray = Manifold.extrude(plateau, TRAY_MM).translate((0, 0, TIBIAL_CUT_MM))
    stem = Manifold.cylinder(42, 5, 8, 48).translate((0, -4, TIBIAL_CUT_MM - 42 + 0.1))
    fins = Manifold.cube((40, 3, 14), True).translate((0, -4, TIBIAL_CUT_MM - 6.9))
    bearing = Manifold.extrude(plateau.offset(-1.5), 13.0 - TRAY_MM).translate((0, 0, TIBIAL_CUT_MM + TRAY_MM))
    return bone, femoral, tray + stem + fins, bearing - femur - femoral


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write two radiographs and the path length in metal as one PNG; the detector has `pixels` x `pixels` pixels."""
    knee = pssf.Knee(jsw_medial_mm=3.0, varus_deg=3.0, osteophytes=(pssf.Osteophyte(site="medial_tibia", size_mm=3.0),))
    built = pssf.build(knee)
    bone, femoral, tray, bearing = make_components(built)
    replaced = (
        built.resect(to_mesh(bone), name="tibial_cut")
        .insert(to_mesh(femoral), "cobalt_chromium", name="femoral_component")
        .insert(to_mesh(tray), "titanium_alloy", name="tibial_tray")
        .insert(to_mesh(bearing), "polyethylene", name="bearing")
    )
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    before = pssf.simulate(built, protocol, rng=1)
    with warnings.catch_warnings():
        # The surgery removes labels such as the joint space, so `simulate` warns that these labels are absent.
        warnings.simplefilter("ignore", pssf.SurgeryNotice)
        after = pssf.simulate(replaced, protocol, rng=1, keep=("path_mm",))
    print(f"medial joint space before: {before.truth.jsw_medial_mm:.2f} mm; after: {after.truth.jsw_medial_mm}")
    for step in after.surgery:
        print(step["step"], step["name"], step["material"] or "")
    window = np.s_[pixels // 4 : pixels * 3 // 4, pixels * 3 // 10 : pixels * 7 // 10]
    panels = [
        make_panel(pssf.render_for_display(radiograph)[window], 500, 400, caption)
        for radiograph, caption in ((before, "before"), (after, "after"))
    ]
    metal_mm = after.kept["path_mm"]["cobalt_chromium"] + after.kept["path_mm"]["titanium_alloy"]
    panels.append(make_panel(apply_heat_map(metal_mm[window], 40.0), 500, 400, "both metals, 0 to 40 mm"))
    return [write_image_row(panels, out / "knee_replacement.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
