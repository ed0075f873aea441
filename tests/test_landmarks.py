"""Check contour landmarks of femur and tibia and their location on projected contours."""

import dataclasses

import numpy as np
import pytest
from conftest import build_once
from numpy.testing import assert_allclose

import pssf
from pssf.anatomy.meshing.solids import build_height_field, extract_mesh, find_edges
from pssf.anatomy.outlines.contour_landmarks import find_contour_landmarks
from pssf.anatomy.outlines.projected_contours import compute_outline_rows, rotate_px
from pssf.core.label_names import CONTOUR_LANDMARKS, FEMORAL_LANDMARKS
from pssf.data.analysis.landmark_table import load_landmark_reference
from pssf.geometry.mesh import Mesh
from pssf.geometry.view import (
    View,
    magnification,
    project_points,
    resolve_view,
)

REFERENCE = pssf.load_protocol("reference")
FLOOR_LANDMARKS = ("tibia_medial_1", "tibia_medial_2")
# View from a source so distant that the magnification is 1.
FAR = View(source_mm=(0.0, -1e7, 0.0), centre_mm=(0.0, 200.0, 0.0), rows=401, cols=401, pixel_mm=0.5)


@pytest.fixture(scope="module")
def landmarks(built):
    return built.truth(REFERENCE).landmarks_px


def find_surface(built, name):
    return next(s.mesh_arrays for s in built.scene.surfaces if s.name == name)


def compute_outline_row(mesh, view, col, lowest):
    """Compute the row at which the outline of a projected mesh crosses a column, which may be fractional."""
    projected = project_points(mesh.vertices, view)
    return compute_outline_rows(
        np.column_stack((projected[:, 0], projected[:, 1] - col + 1e4)), find_edges(mesh.faces), 10_000, 1, lowest
    )[0]


def test_every_annotated_landmark_is_a_label(landmarks):
    assert load_landmark_reference().names == CONTOUR_LANDMARKS
    assert set(CONTOUR_LANDMARKS) <= set(landmarks)
    assert landmarks["notch"] == landmarks["notch_top"]


@pytest.mark.parametrize("protocol", ["reference", "caudal_beam"])
def test_landmarks_are_on_the_projected_contours(built, protocol):
    technique = pssf.load_protocol(protocol)
    for name, (row, col) in built.truth(technique).landmarks_px.items():
        if name in CONTOUR_LANDMARKS and name not in FLOOR_LANDMARKS:
            bone, lowest = ("femur", 1.0) if name in FEMORAL_LANDMARKS else ("tibia", -1.0)
            assert_allclose(
                row, compute_outline_row(find_surface(built, bone), resolve_view(technique), col, lowest), atol=1e-6
            )


def test_landmarks_are_ordered_along_the_contour(landmarks, knee):
    medial = 1 if knee.side == "right" else -1
    for names in (CONTOUR_LANDMARKS[:9], FEMORAL_LANDMARKS):
        assert (np.diff([landmarks[name][1] * medial for name in names]) > 0).all()


def test_landmarks_of_a_left_knee_mirror_those_of_a_right_knee(built, knee):
    femur, tibia = find_surface(built, "femur"), find_surface(built, "tibia")
    right = find_contour_landmarks(femur, tibia, resolve_view(REFERENCE), 1)
    mirrored = [Mesh(mesh.vertices * [-1, 1, 1], mesh.faces[:, ::-1]) for mesh in (femur, tibia)]
    left = find_contour_landmarks(*mirrored, resolve_view(REFERENCE), -1)
    for name, (row, col) in right.items():
        assert_allclose(left[name], (row, REFERENCE.cols - 1 - col), atol=1e-9)


def test_landmark_positions_do_not_depend_on_pixel_size_and_matrix(built, landmarks):
    coarse = dataclasses.replace(REFERENCE, rows=331, cols=501, pixel_mm=0.47)
    for name, (row, col) in built.truth(coarse).landmarks_px.items():
        if name in CONTOUR_LANDMARKS:
            fine = (np.array(landmarks[name]) - (REFERENCE.rows - 1) / 2) * REFERENCE.pixel_mm
            assert_allclose(((row - 165) * 0.47, (col - 250) * 0.47), fine, atol=1e-9)


def test_an_osteophyte_moves_the_edge_landmark_beyond_the_plateau(landmarks, knee):
    beak = next(one for one in knee.osteophytes if one.site == "medial_tibia")
    mm = REFERENCE.pixel_mm / magnification(resolve_view(REFERENCE))
    beyond = (landmarks["tibia_medial_edge"][1] - landmarks["medial_plateau_edge"][1]) * mm
    assert 0.4 * beak.size_mm < beyond < 1.1 * beak.size_mm
    bare = (landmarks["lateral_plateau_edge"][1] - landmarks["tibia_lateral_edge"][1]) * mm
    # Without an osteophyte the rim is round, so the tangent touches it a few millimetres inside the plateau edge.
    assert -5.0 < bare < 0.0


def build_dished_joint(rim_mm, tilt=0.0, spine_mm=9.0):
    """Build a tibial plateau 76 mm wide, concave from front to back, with two spines; and a femur with a notch."""
    x, y = np.linspace(-38, 38, 305), np.linspace(-24, 24, 97)
    gx, gy = np.meshgrid(x, y, indexing="ij")
    spines = spine_mm * np.exp(-(((np.abs(gx) - 8) / 2.5) ** 2) - (gy / 8) ** 2)
    tibia = extract_mesh(build_height_field(x, y, rim_mm * (gy / 24) ** 2 + tilt * gy + spines, -40.0, "tibia"))
    roof = 18 * np.exp(-((gx / 9) ** 2)) + ((gx**2) / 38**2 - 0.3) ** 2 * 6
    slab = extract_mesh(build_height_field(x, y, 0 * gx - roof, -60.0, "femur"))
    return Mesh(slab.vertices * [1, 1, -1] + [0, 0, 5], slab.faces[:, ::-1]), tibia


def test_points_beside_the_spines_are_on_the_floor_or_the_contour():
    for rim in (0.0, 2.0, 5.0):
        landmarks = find_contour_landmarks(*build_dished_joint(rim), FAR, 1)
        for name in FLOOR_LANDMARKS:
            assert_allclose((200 - landmarks[name][0]) * 0.5, 0.0, atol=0.15)
        # The lateral landmarks are on the contour, not on the floor of the plateau.
        for name in ("tibia_lateral_1", "tibia_lateral_2"):
            assert_allclose((200 - landmarks[name][0]) * 0.5, rim, atol=0.15)
        assert_allclose((200 - landmarks["tibia_medial_edge"][0]) * 0.5, rim, atol=1e-3)


def test_the_floor_of_a_tilted_plateau_is_at_a_quarter_of_its_depth():
    landmarks = find_contour_landmarks(*build_dished_joint(0.0, tilt=-0.05), FAR, 1)
    assert_allclose((200 - landmarks["tibia_medial_1"][0]) * 0.5, -0.6, atol=0.05)


@pytest.mark.parametrize("tilt_deg", [-20.0, 20.0])
def test_spines_of_a_plateau_that_is_tilted_in_the_image_are_its_peaks(tilt_deg):
    femur, tibia = build_dished_joint(0.0, spine_mm=2.5)
    cosine, sine = np.cos(np.deg2rad(tilt_deg)), np.sin(np.deg2rad(tilt_deg))
    turn = np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])
    landmarks = find_contour_landmarks(femur, Mesh(tibia.vertices @ turn.T, tibia.faces), FAR, 1)
    for name, x in (("lateral_spine", -8.0), ("medial_spine", 8.0)):
        row, col = landmarks[name]
        # The highest point of the image within the search range would be up to 8 mm away.
        assert_allclose(np.array([(col - 200) * 0.5, 0.0, (200 - row) * 0.5]) @ turn, (x, 0.0, 2.5), atol=0.6)


def test_plateau_landmarks_are_at_fixed_fractions_from_edge_to_spine():
    landmarks = find_contour_landmarks(*build_dished_joint(2.0), FAR, 1)
    x = {name: (col - 200) * 0.5 for name, (_, col) in landmarks.items()}
    assert_allclose((x["tibia_medial_edge"], x["medial_spine"]), (38.0, 8.0), atol=0.1)
    assert_allclose(x["tibia_medial_1"], 38 - 0.392 * 30, atol=0.1)
    assert_allclose(x["tibia_lateral_2"], -38 + 0.709 * 30, atol=0.1)


def test_notch_landmarks_are_at_a_fixed_fraction_of_the_notch_height():
    femur, tibia = build_dished_joint(2.0)
    landmarks = find_contour_landmarks(femur, tibia, FAR, 1)
    low = compute_outline_rows(project_points(femur.vertices, FAR), find_edges(femur.faces), 130, 70, 1.0).max()
    top = landmarks["notch_top"][0]
    for side, fraction in (("lateral", 0.39), ("medial", 0.38)):
        assert_allclose(landmarks[f"femur_{side}_notch"][0], low + fraction * (top - low), atol=0.3)
    half_way = (landmarks["femur_lateral_edge"][1] + landmarks["femur_lateral_notch"][1]) / 2
    assert_allclose(landmarks["femur_lateral_condyle"][1], half_way, atol=0.06)


def test_edge_landmarks_are_points_where_oblique_lines_touch_the_bones(built, landmarks, knee):
    medial = 1 if knee.side == "right" else -1
    for bone, up, angles in (("tibia", -1, (30, 30)), ("femur", 1, (40, 50))):
        # The lines are defined along the axes of the leg, not of the image.
        view, lean = resolve_view(REFERENCE), built.assembly.pose.lean_deg * medial
        rows, cols = rotate_px(project_points(find_surface(built, bone).vertices, view), view, -lean).T
        for (side, out), angle in zip((("medial", medial), ("lateral", -medial)), np.deg2rad(angles), strict=True):
            ((row, col),) = rotate_px(np.array([landmarks[f"{bone}_{side}_edge"]]), view, -lean)
            steep, flat = up * np.cos(angle), out * np.sin(angle)
            assert_allclose(steep * row + flat * col, (steep * rows + flat * cols).max(), atol=1e-6)


def test_the_tibial_edge_and_jsw_do_not_jump_when_the_beam_angle_changes():
    """Check a knee with medial osteophytes in a view in which the anterior rim of the plateau is above its edge."""
    knee = pssf.sample_knee(grade=2, rng=1, grade_table="population")
    protocol = pssf.load_protocol("ap_standing")
    built = build_once(knee, protocol)
    spaces, edges = [], []
    for change_deg in np.arange(-3.0, 3.5, 0.5):
        tilted = built.aim_beam(dataclasses.replace(protocol, beam_angle_deg=protocol.beam_angle_deg + change_deg))
        truth = built.truth(tilted)
        spaces.append(truth.jsw_medial_mm)
        edges.append(np.array(truth.landmarks_px["tibia_medial_edge"]) * protocol.pixel_mm)
    assert np.abs(np.diff(spaces)).max() < 0.1
    assert np.abs(np.diff(edges, axis=0)).max() < 0.4
