import dataclasses
import runpy
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from test_negative import folded_plate

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


def ball(radius_mm=30.0, at=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius_mm)
    mesh.apply_translation(at)
    return mesh


def water(mesh, name="thing", outside="air"):
    return Surface(mesh, inside="water", outside=outside, name=name)


@pytest.mark.parametrize("protocol", [None, PROTOCOL])
def test_nothing_is_wrong_with_a_knee(protocol):
    report = check(build(Knee()), protocol)
    assert report.ok
    assert str(report) == "no faults"


def test_nothing_is_wrong_with_the_phantom_of_the_example(monkeypatch, tmp_path):
    scenes = []

    def look(scene, protocol, **_):
        scenes.append(scene)
        raise InputError("scene = looked at; allowed: no more")

    monkeypatch.setattr("pssf.simulate", look)
    example = runpy.run_path(str(Path(__file__).parents[1] / "examples" / "own_meshes.py"))
    with pytest.raises(InputError, match="looked at"):
        example["run"](tmp_path, 64)
    assert str(check(scenes[0])) == "no faults"


def test_the_report_has_the_lines_that_trace_refuses_with():
    open_mesh = trimesh.Trimesh(ball().vertices, ball().faces[1:], process=False)
    scene = Scene([water(open_mesh, "one"), water(ball(), "two"), water(trimesh.Trimesh(), "three")])
    report = check(scene)
    assert not report.ok
    with pytest.raises(InputError) as error:
        trace(scene, PROTOCOL)
    assert str(error.value) == "; ".join(map(str, report.faults))
    assert [(fault.surface, fault.count, fault.outcome) for fault in report.faults] == [
        ("one", 3, "refused"),
        ("three", 0, "refused"),
    ]


def test_what_is_mended_is_in_the_report():
    inverted = ball()
    inverted.invert()
    report = check(Scene([water(inverted)]))
    assert report.ok
    assert str(report) == "mended: thing: mesh is inside out; faces: 1280; flipped outward"


def test_a_mesh_that_overlaps_itself_is_noted():
    both = trimesh.util.concatenate([ball(), ball(at=(20.0, 0.0, 0.0))])
    report = check(Scene([water(both)]))
    assert report.ok
    assert "thing: mesh overlaps itself" in str(report)
    apart = trimesh.util.concatenate([ball(), ball(at=(70.0, 0.0, 0.0))])
    assert str(check(Scene([water(apart)]))) == "no faults"


def test_edges_of_more_than_two_faces_are_noted():
    one, other = trimesh.creation.box(extents=3 * [10]), trimesh.creation.box(extents=3 * [10])
    other.apply_translation([10, 0, 10])
    joined = trimesh.util.concatenate([one, other])
    joined.merge_vertices()
    assert "noted: thing: edges with more than two faces: 1, first " in str(check(Scene([water(joined)])))


def test_a_hole_flush_with_a_wall_is_no_overlap():
    outer, hole = trimesh.creation.box(3 * [40]), trimesh.creation.box(3 * [10])
    hole.apply_translation((15, 0, 0))
    hole.invert()
    for turn_deg in (0, 33):
        mesh = trimesh.util.concatenate([outer, hole])
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(turn_deg), [1, 2, 3]))
        assert str(check(Scene([water(mesh)]))) == "no faults"


def test_faces_with_two_equal_corners_make_no_edges_of_more_than_two_faces():
    box = trimesh.creation.box(3 * [40])
    pointed = trimesh.Trimesh(box.vertices, np.vstack((box.faces, [[3, 3, 3]])), process=False)
    line = "mended: thing: faces with a repeated vertex: 1, first 12; removed"
    assert str(check(Scene([water(pointed)]))) == line


def test_edges_are_named_by_the_vertices_that_the_user_has():
    one, other = trimesh.creation.box(extents=3 * [10]), trimesh.creation.box(extents=3 * [10])
    other.apply_translation([10, 0, 10])
    joined = trimesh.util.concatenate([one, other])
    joined.merge_vertices()
    spare = np.full((7, 3), 99.0)
    shifted = trimesh.Trimesh(np.vstack((spare, joined.vertices)), joined.faces + 7, process=False)
    (fault,) = check(Scene([water(shifted)])).faults
    places = [shifted.vertices[int(number)] for number in fault.first_items[0].split("-")]
    assert_allclose(sorted(place[1] for place in places), [-5, 5])
    assert {(place[0], place[2]) for place in places} == {(5.0, 5.0)}


def leg_with(*surfaces):
    return Scene([Surface(ball(60.0), "muscle", "air", "leg"), *surfaces])


def bone(name, x_mm):
    return Surface(ball(25.0, (x_mm, 0.0, 0.0)), "cortical_bone", "muscle", name)


def test_two_bones_that_overlap_are_noted_with_each_other_and_how_far():
    report = check(leg_with(bone("femur", 0.0), bone("tibia", 10.0)))
    assert report.ok
    lines = str(report).splitlines()
    assert len(lines) == 2
    for name, other in (("femur", "tibia"), ("tibia", "femur")):
        (line,) = [line for line in lines if line.startswith(f"noted: {name}: ")]
        says = f"outside is muscle, but cortical_bone ({other}) is there, over up to "
        assert says in line
        assert line.endswith(f"; it and {other} overlap")
        # Along the rays the two are both there for a lens of 2 sqrt(25^2 - 5^2) mm; the balls are polyhedra.
        assert 47.5 < float(line.split(says)[1].split(" mm")[0]) < 49.0
    assert str(check(leg_with(bone("femur", -25.5), bone("tibia", 25.5)))) == "no faults"


def test_a_screw_that_says_it_is_in_muscle_and_is_in_bone_is_noted():
    screw = trimesh.creation.cylinder(3.0, 30.0)
    (fault,) = check(leg_with(bone("femur", 0.0), Surface(screw, "Ti@4.51", "muscle", "screw"))).faults
    assert (fault.surface, fault.outcome) == ("screw", "noted")
    assert fault.problem.startswith("outside is muscle, but cortical_bone (femur) is there, over up to 5.9")
    assert 100 < fault.count < 250
    right = leg_with(bone("femur", 0.0), Surface(screw, "Ti@4.51", "cortical_bone", "screw"))
    assert str(check(right)) == "no faults"


def test_cartilage_that_shares_a_wall_with_bone_contradicts_nothing():
    tibia, plate = (trimesh.creation.box(bounds=[[-20, -20, low], [20, 20, high]]) for low, high in ((-30, 0), (0, 4)))
    for off_mm in (0.0, 1e-5, -1e-5):
        moved = plate.copy()
        moved.apply_translation((0, 0, off_mm))
        scene = leg_with(Surface(tibia, "cortical_bone", "muscle", "tibia"), Surface(moved, "cartilage", "muscle"))
        assert str(check(scene)) == "no faults"


def test_a_surface_that_names_what_does_not_surround_it_is_refused_as_trace_refuses_it():
    scene = Scene([water(ball()), Surface(ball(10.0), "muscle", "cortical_bone", "inner")])
    report = check(scene)
    assert not report.ok
    noted, refused = str(report).splitlines()
    assert noted.startswith(
        "noted: inner: outside is cortical_bone, but water (thing) is there, over up to 20 mm of a ray"
    )
    assert refused.startswith("refused: cortical_bone: path length is negative, down to -19.96 mm; number of rays")
    assert "; inner: outside is cortical_bone, but water (thing) is there" in refused
    with pytest.raises(
        InputError, match=r"^cortical_bone: path length must be .*, got -.*: inner: outside is cortical_bone, but water"
    ):
        trace(scene, PROTOCOL)


@given(
    depth_mm=st.sampled_from([0.002, 0.03, 0.06, 0.2, 5.0]), engine=st.sampled_from(["embree", "scanline"]),
    side=st.sampled_from([1, -1]),
)  # fmt: skip
def test_what_check_accepts_in_a_view_is_simulated_and_what_it_refuses_trace_refuses(depth_mm, engine, side):
    scene = Scene([Surface(folded_plate(depth_mm, side), "cortical_bone", "air", "plate")])
    report = check(scene, FINE)
    assert report.ok == (depth_mm < 0.05)
    if report.ok:
        paths = trace(scene, FINE, engine=engine)
        assert paths.path_mm["cortical_bone"].min() == pytest.approx(-depth_mm, rel=0.01)
        assert "noted: cortical_bone: path length is slightly negative, down to -0.0" in str(report)
        assert simulate(scene, FINE, engine=engine, paths=paths).pixels.min() > 0
    else:
        with pytest.raises(
            InputError, match=r"^cortical_bone: path length must be .*, got -.*: plate: its mesh overlaps itself or is"
        ):
            trace(scene, FINE, engine=engine)


FINE = dataclasses.replace(load_protocol("reference"), rows=96, cols=96, pixel_mm=0.3)


def test_with_a_protocol_what_no_ray_meets_is_noted():
    scene = Scene([
        water(ball(at=(0.0, -1000.0, 0.0)), "behind"),
        water(ball(at=(0.0, 190.0, 0.0)), "through"),
        water(ball(at=(900.0, 0.0, 0.0)), "beside"),
    ])  # fmt: skip
    lines = str(check(scene, PROTOCOL)).splitlines()
    assert "noted: behind: vertices behind the source: 642; no ray crosses that part" in lines
    assert "noted: beside: covers no pixel; it is not in the image" in lines
    assert any(line.startswith("noted: through: vertices behind the detector: ") for line in lines)
    assert str(check(scene)) == "no faults"
    assert np.ptp(scene.bounds_mm, axis=0).max() < 3000
