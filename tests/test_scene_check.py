"""Check `pssf.check`: the faults that it reports, repairs or rejects, and agreement with `trace`."""

import dataclasses
import runpy
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from test_negative_paths import make_folded_plate

from pssf import (
    InputError,
    Knee,
    Scene,
    Surface,
    build,
    check,
    load_protocol,
    simulate,
    trace,
)

PROTOCOL = dataclasses.replace(load_protocol("reference"), rows=64, cols=64, pixel_mm=5.0)


def make_ball(radius_mm=30.0, at=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius_mm)
    mesh.apply_translation(at)
    return mesh


def make_water_surface(mesh, name="thing", outside="air"):
    return Surface(mesh, inside="water", outside=outside, name=name)


@pytest.mark.parametrize("protocol", [None, PROTOCOL])
def test_a_default_knee_has_no_faults(protocol):
    report = check(build(Knee()), protocol)
    assert report.ok
    assert str(report) == "no faults"


def test_the_phantom_in_the_example_with_user_meshes_has_no_faults(monkeypatch, tmp_path):
    scenes = []

    def record_scene(scene, protocol, **_):
        scenes.append(scene)
        raise InputError("scene recorded")

    monkeypatch.setattr("pssf.simulate", record_scene)
    example = runpy.run_path(str(Path(__file__).parents[1] / "examples" / "own_meshes.py"))
    with pytest.raises(InputError, match="scene recorded"):
        example["run"](tmp_path, 64)
    assert str(check(scenes[0])) == "no faults"


def test_check_reports_the_errors_that_trace_raises():
    open_mesh = trimesh.Trimesh(make_ball().vertices, make_ball().faces[1:], process=False)
    scene = Scene(
        [
            make_water_surface(open_mesh, "one"),
            make_water_surface(make_ball(), "two"),
            make_water_surface(trimesh.Trimesh(), "three"),
        ]
    )
    report = check(scene)
    assert not report.ok
    with pytest.raises(InputError) as error:
        trace(scene, PROTOCOL)
    assert str(error.value) == "; ".join(map(str, report.faults))
    assert [(fault.surface, fault.count, fault.outcome) for fault in report.faults] == [
        ("one", 3, "error"),
        ("three", 0, "error"),
    ]


def test_check_reports_repairs():
    inverted = make_ball()
    inverted.invert()
    report = check(Scene([make_water_surface(inverted)]))
    assert report.ok
    assert str(report) == "repaired: thing: mesh is inside out; faces: 1280; flipped outward"


def test_check_reports_a_mesh_that_overlaps_itself():
    both = trimesh.util.concatenate([make_ball(), make_ball(at=(20.0, 0.0, 0.0))])
    report = check(Scene([make_water_surface(both)]))
    assert report.ok
    assert "thing: mesh overlaps itself" in str(report)
    apart = trimesh.util.concatenate([make_ball(), make_ball(at=(70.0, 0.0, 0.0))])
    assert str(check(Scene([make_water_surface(apart)]))) == "no faults"


def test_check_reports_edges_with_more_than_two_faces():
    one, other = trimesh.creation.box(extents=3 * [10]), trimesh.creation.box(extents=3 * [10])
    other.apply_translation([10, 0, 10])
    joined = trimesh.util.concatenate([one, other])
    joined.merge_vertices()
    assert "warning: thing: edges with more than two faces: 1, first " in str(
        check(Scene([make_water_surface(joined)]))
    )


def test_a_cavity_that_touches_a_wall_is_not_reported_as_an_overlap():
    outer, hole = trimesh.creation.box(3 * [40]), trimesh.creation.box(3 * [10])
    hole.apply_translation((15, 0, 0))
    hole.invert()
    for turn_deg in (0, 33):
        mesh = trimesh.util.concatenate([outer, hole])
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(turn_deg), [1, 2, 3]))
        assert str(check(Scene([make_water_surface(mesh)]))) == "no faults"


def test_degenerate_faces_are_not_counted_as_extra_faces_of_an_edge():
    box = trimesh.creation.box(3 * [40])
    pointed = trimesh.Trimesh(box.vertices, np.vstack((box.faces, [[3, 3, 3]])), process=False)
    line = "repaired: thing: faces with a repeated vertex: 1, first 12; removed"
    assert str(check(Scene([make_water_surface(pointed)]))) == line


def test_reported_edges_have_the_vertex_numbers_of_the_user_mesh():
    one, other = trimesh.creation.box(extents=3 * [10]), trimesh.creation.box(extents=3 * [10])
    other.apply_translation([10, 0, 10])
    joined = trimesh.util.concatenate([one, other])
    joined.merge_vertices()
    spare = np.full((7, 3), 99.0)
    shifted = trimesh.Trimesh(np.vstack((spare, joined.vertices)), joined.faces + 7, process=False)
    (fault,) = check(Scene([make_water_surface(shifted)])).faults
    points = [shifted.vertices[int(number)] for number in fault.first_items[0].split("-")]
    assert_allclose(sorted(point[1] for point in points), [-5, 5])
    assert {(point[0], point[2]) for point in points} == {(5.0, 5.0)}


def make_leg(*surfaces):
    return Scene([Surface(make_ball(60.0), "muscle", "air", "leg"), *surfaces])


def make_bone(name, x_mm):
    return Surface(make_ball(25.0, (x_mm, 0.0, 0.0)), "cortical_bone", "muscle", name)


def test_check_reports_both_overlapping_bones_and_their_overlap_length():
    report = check(make_leg(make_bone("femur", 0.0), make_bone("tibia", 10.0)))
    assert report.ok
    lines = str(report).splitlines()
    assert len(lines) == 2
    for name, other in (("femur", "tibia"), ("tibia", "femur")):
        (line,) = [line for line in lines if line.startswith(f"warning: {name}: ")]
        problem = f"outside is muscle, but rays find cortical_bone ({other}), over up to "
        assert problem in line
        assert line.endswith(f" and {other} overlap")
        # The intersection is a lens 2 sqrt(25^2 - 5^2) mm long; the polyhedra are slightly smaller than the spheres.
        assert 47.5 < float(line.split(problem)[1].split(" mm")[0]) < 49.0
    assert str(check(make_leg(make_bone("femur", -25.5), make_bone("tibia", 25.5)))) == "no faults"


def test_check_reports_a_screw_in_bone_that_is_declared_in_muscle():
    screw = trimesh.creation.cylinder(3.0, 30.0)
    (fault,) = check(make_leg(make_bone("femur", 0.0), Surface(screw, "Ti@4.51", "muscle", "screw"))).faults
    assert (fault.surface, fault.outcome) == ("screw", "warning")
    assert fault.problem.startswith("outside is muscle, but rays find cortical_bone (femur), over up to 5.9")
    assert 100 < fault.count < 250
    right = make_leg(make_bone("femur", 0.0), Surface(screw, "Ti@4.51", "cortical_bone", "screw"))
    assert str(check(right)) == "no faults"


def test_cartilage_that_touches_bone_has_no_faults():
    tibia, plate = (trimesh.creation.box(bounds=[[-20, -20, low], [20, 20, high]]) for low, high in ((-30, 0), (0, 4)))
    for off_mm in (0.0, 1e-5, -1e-5):
        moved = plate.copy()
        moved.apply_translation((0, 0, off_mm))
        scene = make_leg(Surface(tibia, "cortical_bone", "muscle", "tibia"), Surface(moved, "cartilage", "muscle"))
        assert str(check(scene)) == "no faults"


def test_check_and_trace_reject_a_surface_with_a_wrong_outside_material():
    scene = Scene([make_water_surface(make_ball()), Surface(make_ball(10.0), "muscle", "cortical_bone", "inner")])
    report = check(scene)
    assert not report.ok
    warning_line, error_line = str(report).splitlines()
    assert warning_line.startswith(
        "warning: inner: outside is cortical_bone, but rays find water (thing), over up to 20 mm of a ray"
    )
    assert error_line.startswith("error: cortical_bone: path length is negative, down to -19.96 mm; number of rays")
    assert "; inner: outside is cortical_bone, but rays find water (thing)" in error_line
    with pytest.raises(
        InputError,
        match=r"^cortical_bone: path length must be .*, got -.*: inner: outside is cortical_bone, but rays find water",
    ):
        trace(scene, PROTOCOL)


@given(
    depth_mm=st.sampled_from([0.002, 0.03, 0.06, 0.2, 5.0]), engine=st.sampled_from(["embree", "scanline"]),
    side=st.sampled_from([1, -1]),
)  # fmt: skip
def test_check_accepts_a_folded_mesh_exactly_when_trace_does(depth_mm, engine, side):
    scene = Scene([Surface(make_folded_plate(depth_mm, side), "cortical_bone", "air", "plate")])
    report = check(scene, FINE)
    assert report.ok == (depth_mm < 0.05)
    if report.ok:
        paths = trace(scene, FINE, engine=engine)
        assert paths.path_mm["cortical_bone"].min() == pytest.approx(-depth_mm, rel=0.01)
        assert "warning: cortical_bone: path length is slightly negative, down to -0.0" in str(report)
        assert simulate(scene, FINE, engine=engine, paths=paths).pixels.min() > 0
    else:
        with pytest.raises(
            InputError, match=r"^cortical_bone: path length must be .*, got -.*: plate: mesh overlaps itself or is"
        ):
            trace(scene, FINE, engine=engine)


FINE = dataclasses.replace(load_protocol("reference"), rows=96, cols=96, pixel_mm=0.3)


def test_check_with_a_protocol_reports_surfaces_that_no_ray_crosses():
    scene = Scene([
        make_water_surface(make_ball(at=(0.0, -1000.0, 0.0)), "behind"),
        make_water_surface(make_ball(at=(0.0, 190.0, 0.0)), "through"),
        make_water_surface(make_ball(at=(900.0, 0.0, 0.0)), "beside"),
    ])  # fmt: skip
    lines = str(check(scene, PROTOCOL)).splitlines()
    assert "warning: behind: vertices behind the source: 642; no ray crosses them" in lines
    assert "warning: beside: covers no pixel; surface is not in the image" in lines
    assert any(line.startswith("warning: through: vertices behind the detector: ") for line in lines)
    assert str(check(scene)) == "no faults"
    assert np.ptp(scene.bounds_mm, axis=0).max() < 3000
