"""Implants and resections: path lengths, densities, labels and masks of a knee after surgery."""

import dataclasses
import pickle
import warnings
from functools import cache

import numpy as np
import pytest
import trimesh
from brute_rays import BruteRays, crossings, rays_of
from manifold3d import Manifold

import pssf
from pssf.anatomy.solids import mesh_of, solid_of

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


def protocol_of(name="reference", pixels=96, field_mm=154.0, **changes):
    changes = {"rows": pixels, "cols": pixels, "pixel_mm": field_mm / pixels, **changes}
    return dataclasses.replace(pssf.load_protocol(name), **changes)


@cache
def knee(name):
    return pssf.build({"right": pssf.Knee(), "left": LEFT}[name])


def rod(start, end, radius, sections=24):
    return trimesh.creation.cylinder(radius=radius, segment=[start, end], sections=sections)


def box(*bounds):
    return trimesh.creation.box(bounds=bounds)


def outer(built, name):
    vertices, faces = next(s for s in built.scene.surfaces if s.name == name).arrays
    return solid_of(vertices, faces, name)


def femoral_component(built):
    """The end of the femur beyond a box, so that it shares faces with the bone."""
    low, high = (-60, -20, 10), (60, 12, 90)
    cut = Manifold.cube(tuple(np.subtract(high, low))).translate(low)
    return (outer(built, "femur") - cut).trim_by_plane((0, 0, -1), -26).decompose()[0]


def screw(built):
    return [(rod((-48, 2, 12), (44, -4, 21), 2.3), "titanium_alloy")]


def plate_and_screws(built):
    side = 1 if built.knee.side == "right" else -1
    plate = box((-46, -14, -60), (-34, 8, -14)) if side > 0 else box((34, -14, -60), (46, 8, -14))
    screws = [rod((-55 * side, 0, z), (30 * side, 2, z - 3), 2.0) for z in (-20, -32)]
    return [(plate, "stainless_steel"), *((one, "Ti@4.51") for one in screws)]


def nail(built):
    return [(rod((0, -8, -165), (0, -14, 4), 5.5), "titanium_alloy")]


def pin_through_the_skin(built):
    return [(rod((-110, 3, -40), (110, -5, -28), 2.5), "stainless_steel")]


def knee_replacement(built):
    component = mesh_of(femoral_component(built))
    return [
        (box((-60, -50, -9), (60, 50, 2.6)), None),
        (component, "cobalt_chromium"),
        (box((-34, -22, -9), (34, 20, -5)), "titanium_alloy"),
        (rod((0, 0, -45), (0, 0, -6), 6.0), "titanium_alloy"),
        (box((-33, -21, -5), (33, 19, 1)), "polyethylene"),
    ]


OPERATIONS = (screw, plate_and_screws, nail, pin_through_the_skin, knee_replacement)


def operated(built, steps):
    for number, (mesh, material) in enumerate(steps):
        name = f"step_{number}"
        built = built.resect(mesh, name=name) if material is None else built.insert(mesh, material, name=name)
    return built


@cache
def brute(name, view):
    """Rays through the joint and its surroundings, crossed with the knee as it is."""
    protocol = protocol_of(pixels=24, field_mm=100.0, **VIEWS[view])
    rng = np.random.default_rng(5)
    return protocol, BruteRays(knee(name).scene, protocol, np.sort(rng.choice(24 * 24, 60, replace=False)))


@pytest.mark.parametrize("operation", OPERATIONS, ids=lambda one: one.__name__)
@pytest.mark.parametrize(("name", "view"), [("right", "straight"), ("right", "tilted"), ("left", "tilted")])
@pytest.mark.parametrize("texture", [True, False])
def test_paths_are_those_of_a_sum_in_which_the_implant_wins(operation, name, view, texture):
    protocol, rays = brute(name, view)
    steps = operation(knee(name))
    built = operated(knee(name), steps)
    wanted, even = rays.paths(steps, texture=texture)
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

