"""Check implants and resections: path lengths, densities, labels and masks of a knee after surgery."""

import dataclasses
import pickle
import warnings
from functools import cache, lru_cache

import numpy as np
import pytest
import trimesh
from brute_force_rays import BruteForceRays
from conftest import build_once
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from manifold3d import Manifold

import pssf
from pssf.anatomy.meshing.solids import build_solid, extract_mesh
from pssf.anatomy.meshing.uncut_faces import restore_uncut_faces

LEFT = pssf.Knee(
    side="left",
    osteophytes=(pssf.Osteophyte(site="medial_tibia", size_mm=3.0),),
    cysts=(pssf.Cyst(site="lateral_tibia", diameter_mm=6.0),),
    jsw_medial_mm=3.0,
)
VIEWS = {
    "straight": {"beam_angle_deg": 0.0},
    "tilted": {"beam_angle_deg": 10.0, "sdd_mm": 1300.0},
}


def make_protocol(name="reference", pixels=96, field_mm=154.0, **changes):
    changes = {"rows": pixels, "cols": pixels, "pixel_mm": field_mm / pixels, **changes}
    return dataclasses.replace(pssf.load_protocol(name), **changes)


@cache
def build_knee(name):
    return build_once({"right": pssf.Knee(), "left": LEFT}[name])


def make_rod(start, end, radius, sections=24):
    return trimesh.creation.cylinder(radius=radius, segment=[start, end], sections=sections)


def make_box(*bounds):
    return trimesh.creation.box(bounds=bounds)


def build_outer_solid(built, name):
    vertices, faces = next(s for s in built.scene.surfaces if s.name == name).mesh_arrays
    return build_solid(vertices, faces, name)


def make_femoral_component(built):
    """Make a component from the end of the femur outside a box; its surface coincides with the bone surface."""
    low, high = (-60, -20, 10), (60, 12, 90)
    cut = Manifold.cube(tuple(np.subtract(high, low))).translate(low)
    return (build_outer_solid(built, "femur") - cut).trim_by_plane((0, 0, -1), -26).decompose()[0]


def make_screw(built):
    return [(make_rod((-48, 2, 12), (44, -4, 21), 2.3), "titanium_alloy")]


def make_plate_and_screws(built):
    side = 1 if built.knee.side == "right" else -1
    plate = make_box((-46, -14, -60), (-34, 8, -14)) if side > 0 else make_box((34, -14, -60), (46, 8, -14))
    screws = [make_rod((-55 * side, 0, z), (30 * side, 2, z - 3), 2.0) for z in (-20, -32)]
    return [(plate, "stainless_steel"), *((one, "Ti@4.51") for one in screws)]


def make_nail(built):
    return [(make_rod((0, -8, -165), (0, -14, 4), 5.5), "titanium_alloy")]


def make_pin_through_skin(built):
    return [(make_rod((-110, 3, -40), (110, -5, -28), 2.5), "stainless_steel")]


def make_pins_in_bone(built):
    """Make one pin in trabecular bone, and one in trabecular bone and marrow."""
    return [
        (make_rod((-20, -4, 22), (20, -6, 24), 3.0), "cobalt_chromium"),
        (make_rod((-9, -6, -38), (9, -6, -41), 3), "Ti@4.51"),
    ]


def make_knee_replacement(built):
    component = extract_mesh(make_femoral_component(built))
    return [
        (make_box((-60, -50, -9), (60, 50, 2.6)), None),
        (component, "cobalt_chromium"),
        (make_box((-34, -22, -9), (34, 20, -5)), "titanium_alloy"),
        (make_rod((0, 0, -45), (0, 0, -6), 6.0), "titanium_alloy"),
        (make_box((-33, -21, -5), (33, 19, 1)), "polyethylene"),
    ]


OPERATIONS = (
    make_screw,
    make_plate_and_screws,
    make_nail,
    make_pin_through_skin,
    make_pins_in_bone,
    make_knee_replacement,
)


def apply_surgery(built, steps):
    for number, (mesh, material) in enumerate(steps):
        name = f"step_{number}"
        built = built.resect(mesh, name=name) if material is None else built.insert(mesh, material, name=name)
    return built


@lru_cache(maxsize=4)
def operate(operation, name):
    """Return the steps of an operation and the knee after it."""
    steps = operation(build_knee(name))
    return steps, apply_surgery(build_knee(name), steps)


@cache
def trace_brute_force(name, view):
    """Make brute-force rays through the joint of the knee before surgery."""
    protocol = make_protocol(pixels=24, field_mm=115.0, **VIEWS[view])
    rng = np.random.default_rng(5)
    return protocol, BruteForceRays(build_knee(name).scene, protocol, np.sort(rng.choice(24 * 24, 60, replace=False)))


# Cases (operation, view, texture), in which every pair of two of these properties occurs.
SURGICAL_CASES = [
    pytest.param(operation, *view, (number + other) % 2 == 0, id=f"{operation.__name__}-{'-'.join(view)}")
    for number, operation in enumerate(OPERATIONS)
    for other, view in enumerate([("right", "straight"), ("left", "tilted")])
]


@pytest.mark.parametrize(("operation", "name", "view", "texture"), SURGICAL_CASES)
def test_paths_after_surgery_agree_with_brute_force_ray_tracing(operation, name, view, texture):
    protocol, rays = trace_brute_force(name, view)
    steps, built = operate(operation, name)
    wanted, even = rays.trace_paths(steps, texture=texture)
    assert even.mean() > 0.97
    for engine in ("embree", "scanline"):
        paths = pssf.trace(built, protocol, engine=engine, precision="float64", texture=texture)
        assert paths.audit.unrepaired == 0
        for material, path_mm in paths.path_mm.items():
            expected = wanted.get(material, np.zeros(len(even)))
            apart_mm = np.abs(path_mm.ravel()[rays.pixels] - expected)[even]
            assert apart_mm.max() < 1e-6, (engine, material)
    metals = {material for _, material in steps if material}
    assert all(wanted[metal][even].max() > 0 for metal in metals)


positions = st.tuples(st.floats(-40, 40), st.floats(-25, 25), st.floats(-60, 60))


@settings(max_examples=8, deadline=None)
@given(start=positions, direction=positions, radius=st.floats(1.0, 8.0))
def test_a_rod_replaces_the_same_path_length_of_tissue_by_metal(start, direction, radius):
    end = np.add(start, direction)
    assume(np.linalg.norm(direction) > 5 and np.abs(end).max() < 62)
    body = make_rod(start, end, radius)
    protocol = make_protocol(pixels=48)
    before, after = (
        pssf.trace(built, protocol, engine="scanline", precision="float64", texture=False).path_mm
        for built in (build_knee("right"), build_knee("right").insert(body, "titanium_alloy"))
    )
    alone = pssf.trace(pssf.Scene([pssf.Surface(body, "titanium_alloy", "air")]), protocol, precision="float64")
    metal_mm = alone.path_mm["titanium_alloy"]
    assert np.abs(after["titanium_alloy"] - metal_mm).max() < 1e-9
    beside = metal_mm == 0
    assert all(np.abs(after[material] - before[material])[beside].max() < 1e-9 for material in before)
    # Adjacent tissues overlap by up to 3e-5 mm, and a rod removes this overlap.
    assert all((after[material] <= before[material] + 1e-4).all() for material in before)
    assert np.abs(sum(before.values()) - sum(after.values())).max() < 1e-9


def test_cutting_a_mesh_does_not_change_distant_faces():
    whole = next(s for s in build_knee("right").scene.surfaces if s.name == "intermuscular_fat").mesh_arrays
    solid = build_solid(whole.vertices, whole.faces, "fat")
    cut = restore_uncut_faces(extract_mesh(solid - Manifold.sphere(6.0, 32).translate((30, -18, 110))), whole)
    # Faces with all vertices far from the ball are the same before and after the cut.
    after, before = (
        {
            frozenset(map(tuple, corners))
            for corners in mesh.vertices[mesh.faces]
            if np.linalg.norm(corners - (30, -18, 110), axis=1).min() > 30
        }
        for mesh in (cut, whole)
    )
    assert len(before) > 10_000
    assert after == before


def test_an_implant_within_bone_changes_no_label():
    whole, (_, drilled) = build_knee("right"), operate(make_screw, "right")
    for name in ("reference", "fixed_flexion"):
        protocol = make_protocol(name)
        built = whole if name == "reference" else build_once(pssf.Knee(), protocol)
        after = drilled if name == "reference" else apply_surgery(built, make_screw(built))
        assert after.truth(protocol) == built.truth(protocol)
        assert after.measure_jsw_mm(protocol) == built.measure_jsw_mm(protocol)


def test_a_replaced_joint_has_no_joint_space_and_no_grade():
    graded = dataclasses.replace(pssf.sample_knee(grade=2, rng=4, grade_table="paper"), side="left")
    whole = pssf.build(graded)
    after = apply_surgery(whole, make_knee_replacement(whole))
    protocol = make_protocol()
    before = whole.truth(protocol)
    with pytest.warns(pssf.SurgeryNotice, match="medial and lateral"):
        truth = after.truth(protocol)
    assert before.grade == 2
    assert (truth.grade, truth.reader_grade) == (None, None)
    assert (truth.jsw_medial_mm, truth.jsw_lateral_mm) == (None, None)
    assert not truth.jsw_at_mm
    assert not truth.attrition_mm
    assert not [name for name in truth.readings if name.startswith("XR") or "jsw" in name]
    assert "inter_margin_mm" not in truth.readings
    assert truth.readings["femorotibial_deg"] == before.readings["femorotibial_deg"]
    for gone in ("joint_centre", "medial_joint_line", "tibia_medial_1", "medial_spine", "medial_plateau_edge"):
        assert gone not in truth.landmarks_px
    assert truth.landmarks_px["medial_epicondyle"] == before.landmarks_px["medial_epicondyle"]
    with pytest.raises(pssf.InputError, match="joint space must be visible and unchanged by surgery"):
        after.measure_jsw_mm(protocol)
    with pytest.raises(pssf.InputError, match="plateau must be visible"):
        after.inter_margin_mm(protocol)


def test_a_unicondylar_implant_preserves_labels_of_the_other_compartment():
    whole = build_knee("right")
    after = whole.insert(make_box((8, -30, -8), (45, 25, 4)), "cobalt_chromium", name="unicondylar")
    with pytest.warns(pssf.SurgeryNotice, match="replaces the medial joint"):
        truth = after.truth(make_protocol())
    before = whole.truth(make_protocol())
    assert truth.jsw_medial_mm is None
    assert truth.jsw_lateral_mm == before.jsw_lateral_mm
    assert truth.jsw_at_mm == {at: mm for at, mm in before.jsw_at_mm.items() if at > 0.5}
    assert truth.readings["XRJSL"] == before.readings["XRJSL"]
    assert not {"XRJSM", "XRSCFM", "XROSTM"} & set(truth.readings)
    assert truth.landmarks_px["tibia_lateral_1"] == before.landmarks_px["tibia_lateral_1"]


def test_metal_over_the_joint_removes_the_label_only_in_that_view():
    whole = build_knee("right")
    # The clip is in the muscle behind the joint, away from both bones.
    after = whole.insert(make_box((15, 38, -3), (25, 41, 8)), "titanium_alloy", name="clip")
    with pytest.warns(pssf.SurgeryNotice, match="covers the medial joint space in this view"):
        truth = after.truth(make_protocol())
    before = whole.truth(make_protocol())
    assert truth.jsw_medial_mm is None
    hidden = {f"medial_jsw_{bone}" for bone in ("femur", "tibia")}
    assert truth.landmarks_px == {name: at for name, at in before.landmarks_px.items() if name not in hidden}
    assert truth.readings["XRJSM"] == before.readings["XRJSM"]
    above = make_protocol(beam_angle_deg=-14.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", pssf.SurgeryNotice)
        assert after.truth(above) == whole.truth(above)


def test_lateral_view_labels_describe_the_remaining_bone():
    protocol = make_protocol("lateral")
    whole = pssf.build(pssf.Knee(), protocol)
    high = whole.scene.bounds_mm[1]
    # In the lateral view the beam is along the x axis of the leg; the plateau is near z = 0.
    after = whole.resect(make_box((-high[0], -high[1], -12), (high[0], high[1], 3)), name="cut")
    with pytest.warns(pssf.SurgeryNotice):
        truth = after.truth(protocol)
    before = whole.truth(protocol)
    assert "medial_plateau_anterior" not in truth.landmarks_px
    assert truth.landmarks_px["patella_apex"] == before.landmarks_px["patella_apex"]
    assert truth.jsw_medial_mm is None


def test_a_resected_osteophyte_has_no_mask():
    whole = build_knee("left")
    vertices = whole.osteophyte_meshes()["medial_tibia"].vertices
    low, high = vertices.min(axis=0) - 0.5, vertices.max(axis=0) + 0.5
    assert "medial_tibia_osteophyte" in whole.part_meshes()
    assert "medial_tibia_osteophyte" not in whole.resect(make_box(low, high), name="trim").part_meshes()


def test_a_partly_resected_osteophyte_has_a_smaller_mask_and_no_grade():
    whole = build_knee("left")
    mesh = whole.osteophyte_meshes()["medial_tibia"]
    # The x axis points laterally in a left knee, so the smallest x is medial.
    tip = mesh.vertices[mesh.vertices[:, 0].argmin()]
    after = whole.resect(make_box(tip - 1.5, tip + 1.5), name="trim")
    left = after.part_meshes()["medial_tibia_osteophyte"]
    assert 0 < left.as_trimesh().volume < 0.99 * mesh.as_trimesh().volume
    before, truth = (built.truth(make_protocol()) for built in (whole, after))
    assert set(before.readings) - set(truth.readings) == {"XROSTM"}
    assert truth.jsw_medial_mm == before.jsw_medial_mm


def test_masks_contain_the_implant_and_the_remaining_bone(tmp_path):
    _, after = operate(make_knee_replacement, "right")
    protocol = make_protocol(pixels=128)
    with pytest.warns(pssf.SurgeryNotice, match="replaces the medial and lateral joint contours; "):
        radiograph = pssf.simulate(after, protocol, keep=("masks", "path_mm"), engine="scanline")
    masks, paths = radiograph.truth.masks, radiograph.kept["path_mm"]
    assert (masks["step_1"] == (paths["cobalt_chromium"] > 0)).mean() > 0.9999
    bone = paths["cortical_bone"] + paths["trabecular_bone"] + paths["marrow"] > 1e-3
    shadow = np.any([masks[name] for name in ("femur", "tibia", "fibula", "patella")], axis=0)
    assert (bone & ~shadow).sum() <= 2
    # Rays that graze bone or metal may be exceptions.
    assert (shadow & ~bone).mean() < 0.002
    for suffix in ("tif", "dcm"):
        path = pssf.save_masks(radiograph, tmp_path / f"masks.{suffix}")
        loaded = pssf.load_masks(path)
        assert list(loaded) == list(masks)
        assert all(np.array_equal(loaded[name], masks[name]) for name in masks)


def test_the_dicom_segmentation_codes_an_implant_as_implant(tmp_path):
    import pydicom

    _, after = operate(make_screw, "right")
    radiograph = pssf.simulate(after, make_protocol(), keep=("masks",), engine="scanline")
    segments = pydicom.dcmread(pssf.save_masks(radiograph, tmp_path / "masks.dcm")).SegmentSequence
    codes = {one.SegmentLabel: one.SegmentedPropertyTypeCodeSequence[0].CodeMeaning for one in segments}
    assert codes["step_0"] == "Implant"
    assert codes["femur"] == "Femur"


def test_a_radiograph_records_its_implants(tmp_path):
    built, protocol = build_knee("right"), make_protocol()
    after = built.insert(make_screw(built)[0][0], "titanium_alloy", name="screw")
    radiograph = pssf.simulate(after, protocol, seed=3, engine="scanline")
    (step,) = radiograph.surgery
    assert (step["step"], step["name"], step["material"]) == ("insert", "screw", "titanium_alloy")
    for suffix in ("tif", "dcm"):
        loaded = pssf.load(pssf.save(radiograph, tmp_path / f"one.{suffix}"))
        assert loaded == radiograph
        assert loaded.surgery == radiograph.surgery
    again = built.insert(make_screw(built)[0][0], "titanium_alloy", name="screw")
    assert pssf.simulate(again, protocol, seed=3, engine="scanline") == radiograph
    other = pssf.simulate(built, protocol, seed=3, engine="scanline")
    assert other != radiograph
    assert dataclasses.replace(other, pixels=radiograph.pixels) != radiograph
    longer = make_rod((-48, 2, 12), (40, -4, 21), 2.3)
    assert built.insert(longer, "titanium_alloy", name="screw").surgery_table() != after.surgery_table()


def test_a_saved_radiograph_is_not_overwritten_by_one_with_an_implant(tmp_path):
    built, protocol = build_knee("right"), make_protocol()
    from pssf.io.radiograph_files import save_formats

    save_formats(pssf.simulate(built, protocol, engine="scanline"), tmp_path / "one", ("tif",))
    after = pssf.simulate(operate(make_screw, "right")[1], protocol, engine="scanline")
    with pytest.raises(pssf.InputError, match="another surgery"):
        save_formats(after, tmp_path / "one", ("tif",))


def test_metadata_of_a_knee_without_surgery_have_no_surgery_entry(tmp_path):
    radiograph = pssf.simulate(build_knee("right"), make_protocol(), engine="scanline")
    assert radiograph.surgery == ()
    from pssf.io.metadata import encode_metadata

    assert "surgery" not in encode_metadata(radiograph)


def test_each_knee_of_a_pair_keeps_its_own_implants():
    protocol = make_protocol("bilateral", pixels=128, field_mm=400.0)
    right, left = (build_once(pssf.Knee(side=side), protocol) for side in ("right", "left"))
    pair = (right.insert(make_rod((-30, 0, 20), (30, 0, 25), 3), "titanium_alloy", name="screw"), left)
    radiograph = pssf.simulate(pair, protocol, keep=("masks",), engine="scanline")
    assert [step["name"] for step in radiograph.surgery] == ["right_screw"]
    assert "screw" in radiograph.truths[0].masks
    assert "screw" not in radiograph.truths[1].masks


def test_a_pickled_knee_keeps_its_implants():
    after = apply_surgery(build_knee("right"), make_screw(build_knee("right")))
    # The solids of the surgical steps are built before pickling.
    assert all(step.solid for step in after.surgery)
    copied = pickle.loads(pickle.dumps(after))
    assert copied.surgery_table() == after.surgery_table()
    assert len(copied.scene.surfaces) == len(after.scene.surfaces)


def test_an_inverted_implant_is_flipped_with_a_warning():
    inverted = make_rod((-40, 0, 12), (40, 0, 15), 3.0)
    inverted.invert()
    after = build_knee("right").insert(inverted, "titanium_alloy")
    with pytest.warns(pssf.MeshNotice, match="implant: mesh is inside out"):
        paths = pssf.trace(after, make_protocol(), engine="scanline")
    assert paths.path_mm["titanium_alloy"].max() == pytest.approx(6.0, abs=0.2)


@pytest.mark.parametrize(
    ("mesh", "changes", "text"),
    [
        (
            trimesh.Trimesh(*(lambda m: (m.vertices, m.faces[1:]))(make_box((0, 0, 0), (5, 5, 5)))),
            {},
            "edges of a hole",
        ),
        (
            trimesh.util.concatenate([make_box((0, 0, 0), (5, 5, 5)), make_box((3, 3, 3), (8, 8, 8))]),
            {},
            "must not overlap",
        ),
        (make_box((0, 0, 0), (5, 5, 5)), {"name": "femur"}, "name must be unused in the knee"),
        (make_box((0, 0, 0), (5, 5, 5)), {"name": "medial_tibia_osteophyte"}, "name must be 1 to 50"),
        (make_box((0, 0, 0), (5, 5, 5)), {"name": "a screw"}, "name must be 1 to 50"),
        (make_box((0, 0, 0), (5, 5, 5)), {"material": ""}, "material must be the name"),
        ("screw.stl", {}, "mesh must be a trimesh.Trimesh"),
    ],
)
def test_an_invalid_implant_raises_an_error(mesh, changes, text):
    with pytest.raises(pssf.InputError, match=text) as caught:
        build_knee("right").insert(mesh, **{"material": "titanium_alloy", **changes})
    assert "\n" not in str(caught.value)


def test_a_resection_outside_bone_raises_an_error():
    with pytest.raises(pssf.InputError, match="must intersect bone"):
        build_knee("right").resect(make_box((500, 0, 0), (505, 5, 5)))


def test_changing_an_inserted_mesh_does_not_change_the_knee():
    mesh = make_rod((-40, 0, 12), (40, 0, 15), 3.0)
    after = build_knee("right").insert(mesh, "titanium_alloy")
    table = after.surgery_table()
    mesh.apply_translation((0, 0, 50))
    assert after.surgery_table() == table


@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda one: one.__name__)
def test_check_finds_no_faults_in_a_knee_with_implants(operation):
    _, built = operate(operation, "right")
    assert str(pssf.check(built)) == "no faults"


def test_resecting_bone_around_an_implant_preserves_the_implant():
    built = build_knee("right").insert(make_rod((-20, 0, 14), (20, 0, 14), 2), "titanium_alloy", name="pin")
    after = built.resect(make_box((-60, -60, 5), (0, 60, 40)), name="cut")
    steps = [(make_rod((-20, 0, 14), (20, 0, 14), 2), "titanium_alloy"), (make_box((-60, -60, 5), (0, 60, 40)), None)]
    protocol, rays = trace_brute_force("right", "straight")
    wanted, even = rays.trace_paths(steps, texture=True)
    paths = pssf.trace(after, protocol, precision="float64")
    for material, path_mm in paths.path_mm.items():
        expected = wanted.get(material, np.zeros(len(even)))
        assert np.abs(path_mm.ravel()[rays.pixels] - expected)[even].max() < 1e-6, material


def test_monte_carlo_scatter_includes_implants(tmp_path):
    _, after = operate(make_plate_and_screws, "right")
    protocol = make_protocol(pixels=64, scatter="monte_carlo", scatter_photons=20_000)
    counted = pssf.simulate(after, protocol, engine="scanline", keep=("scatter",)).kept["scatter"]
    bare = pssf.simulate(build_knee("right"), protocol, engine="scanline", keep=("scatter",)).kept["scatter"]
    assert np.isfinite(counted).all()
    # Metal attenuates scatter as well as primary.
    assert 0.5 * bare.mean() < counted.mean() < bare.mean()


def test_a_knee_with_implants_is_exported_with_its_implants(tmp_path):
    _, after = operate(make_screw, "right")
    paths = pssf.export_meshes(after.scene, tmp_path, formats=("stl", "glb"))
    assert [path.name for path in paths if path.name.endswith("step_0.stl")]
    read = pssf.read_mesh(next(path for path in paths if path.name.endswith("step_0.stl")))
    assert abs(read.volume / after.scene.surfaces[-1].mesh.volume - 1) < 1e-5
