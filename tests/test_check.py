import dataclasses

import numpy as np
import pytest
import trimesh

from pssf import InputError, Knee, Scene, Surface, build, check, load_protocol, trace

PROTOCOL = dataclasses.replace(load_protocol("reference"), rows=64, cols=64, pixel_mm=5.0)


def ball(radius_mm=30.0, at=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius_mm)
    mesh.apply_translation(at)
    return mesh


def water(mesh, name="thing", outside="air"):
    return Surface(mesh, inside="water", outside=outside, name=name)


def test_nothing_is_wrong_with_a_knee():
    report = check(build(Knee()), load_protocol("reference"))
    assert report.ok
    assert str(report) == "no faults"


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
    assert str(report) == "mended: thing: mesh is inside out; faces: 1280; turned outward"


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
    assert "noted: thing: edges of more than two faces: 1, first " in str(check(Scene([water(joined)])))


def test_a_surface_that_names_what_does_not_surround_it_is_noted():
    report = check(Scene([water(ball()), Surface(ball(10.0), "muscle", "cortical_bone", "inner")]))
    assert "noted: cortical_bone: path length comes out negative" in str(report)


def test_with_a_protocol_what_no_ray_meets_is_noted():
    scene = Scene([
        water(ball(at=(0.0, -1000.0, 0.0)), "behind"),
        water(ball(at=(0.0, 190.0, 0.0)), "through"),
        water(ball(at=(900.0, 0.0, 0.0)), "beside"),
    ])  # fmt: skip
    lines = str(check(scene, PROTOCOL)).splitlines()
    assert "noted: behind: vertices behind the source: 642; that part is not on the way of any ray" in lines
    assert "noted: beside: covers no pixel; it is not in the image" in lines
    assert any(line.startswith("noted: through: vertices behind the detector: ") for line in lines)
    assert str(check(scene)) == "no faults"
    assert np.ptp(scene.bounds_mm, axis=0).max() < 3000
