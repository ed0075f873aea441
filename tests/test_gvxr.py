"""Compare the ray caster with gVirtualXray (gvxr), which renders triangles with OpenGL.

The tests need gvxr and an OpenGL context, but no GPU, and are skipped without them; tests/README.md describes both.

Both programs render the same polyhedra. gvxr 2.1 has three known errors, in order of size:
- Triangles seen edge-on: OpenGL rounds corners to 1/256 of a pixel and extrapolates the remaining triangle, which gives
  arbitrary values at a few pixels. The artefact filter, on by default, replaces these and other pixels by neighbours.
- Triangles with corners at different depths: points are interpolated linearly across the detector without perspective
  (l_buffer_gl4.vert sets gl_Position.w = 1). Between depths a and b the error is up to (a - b)^2 / 2 (a + b) along the
  ray, always away from the source. Halving all edges reduces it to a quarter.
- Grazed solids: the same rounding to 1/256 of a pixel, and float32.
"""

import dataclasses

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from tissue_materials import compute_attenuation, find_material

import pssf
from pssf.anatomy.meshing.solids import build_solid, extract_mesh
from pssf.geometry.view import resolve_view
from pssf.validation.raycasting.sphere_phantoms import polyhedron_chords_mm
from pssf.xray.resolved_technique import resolve_technique
from pssf.xray.spectrum import compute_reduced_beam

# ImportError also covers a missing system library of an installed gvxr, which the skip reason then names.
gvxr = pytest.importorskip("gvxrPython3", exc_type=ImportError).gvxr

MM_PER_CM = 10.0
KEV_PER_MEV = 1000.0

# A non-square image with an oblique beam reveals flips, transpositions and tilts.
PROTOCOL = dataclasses.replace(pssf.load_protocol("reference"), rows=480, cols=512, pixel_mm=0.6, beam_angle_deg=7.0)
VIEW = resolve_view(PROTOCOL)

# Largest error away from rims, in mm. Errors come from rounding to 1/256 of a pixel and from float32. On llvmpipe,
# 99.9 % of the pixels of a sphere have errors below 9e-4 mm.
ROUNDED_MM = 0.002
# Largest error at rims, in mm. An offset of half a rounding step (0.6 mm / 512) changes the path length at the rim of a
# sphere with a radius of 50 mm by up to sqrt(8 x 50 x 0.6 / 512) = 0.7 mm. The largest measured error is 0.6 mm.
RIM_MM = 1.0
# Largest fraction of pixels with rim errors; 3 in 10 000 were measured.
RIM_FRACTION = 1e-3


@pytest.fixture(scope="module", autouse=True)
def context():
    """Create one OpenGL context with the geometry of VIEW; a second context per process is unreliable."""
    try:
        gvxr.useLogFile("/dev/null")
        gvxr.createWindow(-1, 0, "EGL")
    except RuntimeError as error:
        pytest.skip(f"no OpenGL context: {str(error).splitlines()[0]}")
    gvxr.usePointSource()
    gvxr.setSourcePosition(*VIEW.source_mm, "mm")
    gvxr.setDetectorPosition(*VIEW.centre_mm, "mm")
    gvxr.setDetectorUpVector(0, 0, 1)
    gvxr.setDetectorNumberOfPixels(VIEW.cols, VIEW.rows)
    gvxr.setDetectorPixelSize(VIEW.pixel_mm, VIEW.pixel_mm, "mm")
    gvxr.setMonoChromatic(60, "keV", 1)
    # Setting a beam enables the artefact filter again, so it is disabled afterwards.
    gvxr.disableArtefactFiltering()
    yield
    gvxr.destroy()


@pytest.fixture(autouse=True)
def empty_scene(context):
    """Remove all meshes after each test."""
    yield
    gvxr.removePolygonMeshesFromXRayRenderer()
    gvxr.removePolygonMeshesFromSceneGraph()


@pytest.fixture(scope="module")
def knee_scene():
    return pssf.build(pssf.Knee()).scene


def add_mesh(label, mesh, name="water"):
    """Add a mesh of one material to the scene of gvxr."""
    gvxr.makeTriangularMesh(label, mesh.vertices.ravel().tolist(), mesh.faces.ravel().tolist(), "mm")
    density, weights = find_material(name)
    gvxr.setMixture(label, [z for z, _ in weights], [weight for _, weight in weights])
    gvxr.setDensity(label, density, "g/cm3")
    gvxr.addPolygonMeshAsInnerSurface(label)


def flip_rows(rows):
    """Reverse the rows of an image of gvxr, whose first row is the lowest of the detector."""
    return np.array(rows)[::-1]


def trace_with_gvxr(mesh):
    """Return the (rows, cols) path lengths of gvxr in mm."""
    add_mesh("solid", mesh)
    lengths = flip_rows(gvxr.computeLBuffer("solid")) * MM_PER_CM
    gvxr.removePolygonMeshesFromXRayRenderer()
    return lengths


def trace_with_pssf(mesh):
    """Return the (rows, cols) path lengths of `trace` in mm."""
    scene = pssf.Scene([pssf.Surface(mesh, inside="water", outside="air", name="solid")])
    return pssf.trace(scene, VIEW, engine="scanline").path_mm["water"].astype(np.float64)


def split_edges(mesh, times):
    """Halve every edge of a mesh a number of times."""
    for _ in range(times):
        mesh = mesh.subdivide()
    return mesh


def compute_depth_error_mm(mesh):
    """Return the maximum displacement along a ray by the interpolation of gvxr, in mm."""
    depth = mesh.triangles[..., 1] - VIEW.source_mm[1]
    along = np.ptp(depth, axis=1) ** 2 / (4 * depth.min(axis=1))
    slant = np.hypot(VIEW.rows, VIEW.cols) / 2 * VIEW.pixel_mm / PROTOCOL.sdd_mm
    return float(along.max() * np.sqrt(1 + slant**2))


def get_mesh(scene, name):
    return next(surface.mesh for surface in scene.surfaces if surface.name == name)


def merge_material(scene, material):
    """Merge all surfaces of a material into one mesh, with cavities as inverted surfaces."""
    pieces = []
    for surface in scene.surfaces:
        faces = {surface.inside: surface.mesh.faces, surface.outside: surface.mesh.faces[:, ::-1]}.get(material)
        if faces is not None:
            pieces.append(trimesh.Trimesh(surface.mesh.vertices, faces, process=False))
    return trimesh.util.concatenate(pieces)


def assert_path_lengths_agree(theirs, ours, tolerance_mm):
    """Require agreement within the tolerance; a few rim pixels may differ by up to RIM_MM more."""
    difference = np.abs(theirs - ours)
    assert (difference > tolerance_mm).sum() <= RIM_FRACTION * (ours > 0).sum()
    assert difference.max() < tolerance_mm + RIM_MM


def make_ball(radius_mm, at=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius_mm)
    mesh.apply_translation(at)
    return mesh


def make_frustum():
    """Return a frustum of a pyramid whose apex is the source, so that its four sides are edge-on."""
    source, corner = np.array(VIEW.source_mm), np.array(VIEW.first_pixel_mm)
    cos, sin = np.cos(np.deg2rad(17.0)), np.sin(np.deg2rad(17.0))
    square = 140.0 * np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) @ np.array([(cos, -sin), (sin, cos)])
    # The offset 0.37 keeps the sides away from pixel centres, at which either inside or outside would be correct.
    row, col = square.T + np.array([[240.37], [260.37]])
    projected = corner + VIEW.pixel_mm * np.column_stack((col, np.zeros(4), -row))
    return trimesh.convex.convex_hull(np.concatenate([source + depth * (projected - source) for depth in (0.80, 0.84)]))


def compute_exact_chords_mm(mesh):
    """Return the (rows, cols) exact chords of a convex mesh in mm."""
    return polyhedron_chords_mm(mesh, np.argwhere(np.ones((VIEW.rows, VIEW.cols))), VIEW).reshape(VIEW.rows, VIEW.cols)


def test_path_lengths_of_an_off_centre_sphere_agree_with_gvxr():
    mesh = make_ball(40.0, at=(13.0, 5.0, 22.0))
    ours = trace_with_pssf(mesh)
    assert 79.0 < ours.max() < 80.0
    assert compute_depth_error_mm(mesh) < 0.001
    assert_path_lengths_agree(trace_with_gvxr(mesh), ours, compute_depth_error_mm(mesh) + ROUNDED_MM)


def test_path_lengths_of_nested_spheres_agree_with_gvxr():
    names = ["muscle", "cortical_bone", "marrow", "water", "adipose"]
    meshes = [make_ball(radius, at=(i, -i, 2.0 * i)) for i, radius in enumerate((50.0, 40.0, 30.0, 20.0, 9.0))]
    layers = zip(meshes, names, ["air", *names[:-1]], strict=True)
    scene = pssf.Scene([pssf.Surface(mesh, inside, outside, name=inside) for mesh, inside, outside in layers])
    ours = pssf.trace(scene, VIEW, engine="scanline").path_mm
    for name in names:
        mesh = merge_material(scene, name)
        assert_path_lengths_agree(trace_with_gvxr(mesh), ours[name], 2 * (compute_depth_error_mm(mesh) + ROUNDED_MM))


@pytest.mark.parametrize("name", ["femur", "tibia", "patella"])
def test_path_lengths_of_bones_agree_within_the_error_of_gvxr(knee_scene, name):
    mesh = get_mesh(knee_scene, name)
    assert_path_lengths_agree(trace_with_gvxr(mesh), trace_with_pssf(mesh), compute_depth_error_mm(mesh) + ROUNDED_MM)


def test_the_gvxr_error_falls_with_the_square_of_the_edge_length(knee_scene):
    whole = get_mesh(knee_scene, "femur")
    # The simplified mesh has triangles so long that their depth error exceeds the rounding error.
    mesh = extract_mesh(
        build_solid(np.array(whole.vertices), np.array(whole.faces), "femur").simplify(0.2)
    ).as_trimesh()
    ours = trace_with_pssf(mesh)
    errors = [
        np.percentile(abs(trace_with_gvxr(split_edges(mesh, times)) - ours)[ours > 0], 99.9) for times in range(4)
    ]
    assert 0.1 < errors[0] < compute_depth_error_mm(mesh)
    assert_allclose(errors, errors[0] * 0.25 ** np.arange(4), rtol=0.1)


def test_path_lengths_of_a_box_are_exact_where_gvxr_differs():
    box = trimesh.creation.box(extents=(60, 80, 70))
    box.apply_transform(trimesh.transformations.euler_matrix(*np.deg2rad((20, 33, 47))))
    exact, fine = compute_exact_chords_mm(box), split_edges(box, 6)
    assert np.abs(trace_with_pssf(box) - exact).max() < 5e-6
    assert 2.0 < np.abs(trace_with_gvxr(box) - exact).max() < compute_depth_error_mm(box) + ROUNDED_MM
    assert compute_depth_error_mm(fine) < 0.001
    assert_path_lengths_agree(trace_with_gvxr(fine), exact, compute_depth_error_mm(fine) + ROUNDED_MM)


def test_path_lengths_of_edge_on_faces_are_exact_where_gvxr_fails():
    mesh = split_edges(make_frustum(), 4)
    exact = compute_exact_chords_mm(make_frustum())
    assert np.abs(trace_with_pssf(mesh) - exact).max() < 5e-6
    tolerance_mm = compute_depth_error_mm(mesh) + ROUNDED_MM
    wrong = np.abs(trace_with_gvxr(mesh) - exact) > tolerance_mm
    gvxr.enableArtefactFilteringOnGPU()
    filtered = np.abs(trace_with_gvxr(mesh) - exact) > tolerance_mm
    gvxr.disableArtefactFiltering()
    # With llvmpipe, 4 of 78 000 pixels are wrong by up to 18 m; with the artefact filter, 6 pixels by up to 188 mm.
    assert wrong.sum() < 40
    assert filtered.sum() < 80


def test_attenuation_of_the_tissues_agrees_with_gvxr(knee_scene):
    energies_kev = np.linspace(15.0, 120.0, 22)
    for name in knee_scene.materials[1:]:
        add_mesh(name, make_ball(10.0), name)
        per_cm = [gvxr.getLinearAttenuationCoefficient(name, float(energy), "keV") for energy in energies_kev]
        assert_allclose(np.array(per_cm) / MM_PER_CM, compute_attenuation(name, energies_kev), rtol=1e-12)


def test_the_polychromatic_image_of_a_knee_agrees_with_gvxr(knee_scene):
    beam = compute_reduced_beam(resolve_technique(PROTOCOL), dict.fromkeys(knee_scene.materials[1:], 60.0))
    photons = beam.photons_per_mm2 / beam.photons_per_mm2.sum()
    gvxr.resetBeamSpectrum()
    for energy, count in zip(beam.energies_kev, photons, strict=True):
        gvxr.addEnergyBinToSpectrum(float(energy), "keV", float(count))
    gvxr.disableArtefactFiltering()
    exponent = np.zeros((VIEW.rows, VIEW.cols, len(photons)))
    # Trabecular texture is omitted, because gvxr does not support varying density.
    for name, lengths in pssf.trace(knee_scene, VIEW, engine="scanline", texture=False).path_mm.items():
        # Edges are halved twice; otherwise the depth error of the largest triangles would be 1 % of the image.
        add_mesh(name, split_edges(merge_material(knee_scene, name), 2), name)
        exponent -= lengths[..., None] * compute_attenuation(name, beam.energies_kev)
    ours = (np.exp(exponent) * photons * beam.energies_kev).sum(axis=-1)
    theirs = flip_rows(gvxr.computeXRayImage()) * KEV_PER_MEV
    difference = np.abs(theirs / ours - 1)
    assert 0.0 < ours.min() < 0.1 * ours.max()
    # With llvmpipe, 50 % of pixels differ by less than 6e-8, 99 % by 3e-5 and 99.9 % by 3e-4; rim pixels by 5e-3.
    assert np.percentile(difference, 50) < 1e-6
    assert np.percentile(difference, 99.9) < 1e-3
    # The error at a rim is at most that of RIM_MM of the densest material at the mean energy.
    energy = float((photons * beam.energies_kev).sum())
    rim = np.expm1(RIM_MM * compute_attenuation("cortical_bone", np.array([energy]))[0])
    assert 0.02 < rim < 0.2
    assert difference.max() < rim
