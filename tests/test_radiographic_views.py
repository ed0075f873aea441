"""Check all views: rotation of the leg, beams along the plateau, and labels."""

import dataclasses

import numpy as np
import pytest
from conftest import build_once
from numpy.testing import assert_allclose

import pssf
from pssf import InputError
from pssf.anatomy.bones import small_bones
from pssf.anatomy.meshing.solids import extract_mesh
from pssf.anatomy.posture.plateau_margins import find_plateau_margins
from pssf.anatomy.soft_tissue.limb_bend import build_limb_bend, shear_angle_deg
from pssf.core.label_names import CONTOUR_LANDMARKS
from pssf.data.analysis.reference_table import load_reference_tables
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.data.imaging.dicom_codes import load_dicom_tables
from pssf.data.knees.field_definitions import beam_angle_range_deg
from pssf.geometry.mesh import Mesh
from pssf.geometry.view import magnification, project_points, resolve_view
from pssf.io.dicom import dicom_radiograph
from pssf.validation.imaging import positioning_criteria, view_effects, view_scatter

LATERAL, SKYLINE = (pssf.load_protocol(name) for name in ("lateral", "skyline"))
LYON = pssf.load_protocol("lyon_schuss")
KNEE = pssf.Knee(jsw_medial_mm=4.2, jsw_lateral_mm=5.1, texture_seed=3)


def reduce_matrix(protocol, factor=16):
    rows, cols = protocol.rows // factor, protocol.cols // factor
    return dataclasses.replace(protocol, rows=rows, cols=cols, pixel_mm=protocol.pixel_mm * factor, scatter="none")


@pytest.fixture(scope="module")
def side():
    return build_once(KNEE, LATERAL)


@pytest.fixture(scope="module")
def axial():
    return build_once(KNEE, SKYLINE)


@pytest.fixture(scope="module")
def schuss():
    return build_once(KNEE, LYON)


def make_frontal_protocol(protocol):
    """Convert the protocol of a view to an AP protocol with the same posture."""
    return dataclasses.replace(protocol, projection="AP", beam_along="horizontal")


@pytest.fixture(scope="module")
def upright():
    """Build the same leg in the same posture for an AP view, by view name."""
    return {protocol.name: pssf.build(KNEE, make_frontal_protocol(protocol)) for protocol in (LATERAL, SKYLINE)}


def compute_volume(surface):
    return surface.mesh_arrays.as_trimesh().volume


def test_rotating_the_leg_keeps_the_volume_of_every_surface(side, axial, upright):
    for built, protocol in ((side, LATERAL), (axial, SKYLINE)):
        for one, other in zip(upright[protocol.name].scene.surfaces, built.scene.surfaces, strict=True):
            assert one.name == other.name
            assert compute_volume(other) == pytest.approx(compute_volume(one), rel=1e-9)
            assert compute_volume(other) > 0


def test_a_lateral_view_has_the_patella_left_and_fibula_near_the_detector(side):
    bones = {s.name: s.mesh_arrays.vertices for s in side.scene.surfaces}
    assert bones["fibula"][:, 1].mean() > bones["tibia"][:, 1].mean() + 15
    assert bones["patella"][:, 0].mean() < bones["femur"][:, 0].mean() - 30
    assert bones["fibula"][:, 0].mean() > bones["tibia"][:, 0].mean() + 10


def test_a_skyline_view_has_the_patella_above_the_femur(axial):
    bones = {s.name: s.mesh_arrays.vertices for s in axial.scene.surfaces}
    assert bones["patella"][:, 2].min() > bones["femur"][:, 2].max() - 5
    assert bones["patella"][:, 2].mean() > bones["femur"][:, 2].max() + 5
    # Centres of bounding boxes are compared, because the mean of vertices depends on mesh density.
    middle = {name: (vertices.min(axis=0) + vertices.max(axis=0)) / 2 for name, vertices in bones.items()}
    assert middle["tibia"][1] > 30 > -30 > middle["femur"][1]
    assert bones["fibula"][:, 0].mean() < bones["tibia"][:, 0].mean() - 15


def test_the_beam_of_a_skyline_view_passes_between_patella_and_femur(axial):
    protocol = reduce_matrix(SKYLINE, 4)
    masks = pssf.simulate(axial, protocol, keep=("masks",), engine="scanline").truth.masks
    patella, femur = masks["patella"], masks["femur"]
    assert patella.sum() > 500
    assert (patella & femur).sum() < 0.1 * patella.sum()
    cols = np.flatnonzero(patella.any(axis=0))
    below = [np.flatnonzero(femur[:, col])[0] - np.flatnonzero(patella[:, col])[-1] for col in cols[5:-5]]
    assert 0 <= np.median(below) * protocol.pixel_mm / 1.2 < 12


@pytest.mark.parametrize("name", ["lateral", "skyline"])
def test_trabeculae_rotate_with_their_bones(name, side, axial, upright):
    built, front = {"lateral": side, "skyline": axial}[name], upright[name]
    frontal, rotated = (
        next(s for s in one.scene.surfaces if s.name == "femur_trabecular").inside_density for one in (front, built)
    )
    starts, ends = np.random.default_rng(4).uniform([-25, -15, 10], [25, 15, 40], (2, 50, 3))
    moved = [built.assembly.orient_points(points) for points in (starts, ends)]
    assert not np.allclose(moved[0], starts)
    assert_allclose(rotated.integrate(*moved), frontal.integrate(starts, ends), rtol=1e-7)


def test_lateral_and_axial_views_have_no_joint_space_labels(side, axial):
    for built, protocol in ((side, LATERAL), (axial, SKYLINE)):
        truth = built.truth(protocol)
        assert not truth.jsw_at_mm
        assert not set(truth.landmarks_px) & {*CONTOUR_LANDMARKS, "medial_joint_line", "lateral_joint_line"}
        assert (truth.jsw_medial_mm, truth.jsw_lateral_mm) == (None, None)
        with pytest.raises(InputError, match=r"projection must be AP or PA to measure JSW, got .*"):
            built.measure_jsw_mm(protocol)
        with pytest.raises(InputError, match="projection must be AP or PA"):
            built.inter_margin_mm(protocol)


@pytest.mark.parametrize("name", ["fibula_tip", "patella_apex", "patella_base", "lateral_plateau_posterior"])
def test_lateral_landmarks_are_on_the_edge_of_their_bones(name, side):
    protocol = reduce_matrix(LATERAL, 4)
    truth = pssf.simulate(side, protocol, keep=("masks",), engine="scanline").truth
    mask = truth.masks[{"fibula": "fibula", "patella": "patella", "lateral": "tibia"}[name.split("_")[0]]]
    row, col = (round(value) for value in truth.landmarks_px[name])
    assert mask[row - 2 : row + 3, col - 2 : col + 3].any()
    # The medial plateau may project behind the lateral one.
    if name != "lateral_plateau_posterior":
        assert not mask[row - 2 : row + 3, col - 2 : col + 3].all()


def test_labels_of_a_left_lateral_view_mirror_those_of_a_right_one(side):
    left = pssf.build(dataclasses.replace(KNEE, side="left"), LATERAL).truth(LATERAL).landmarks_px
    for name, (row, col) in side.truth(LATERAL).landmarks_px.items():
        assert_allclose(left[name], (row, LATERAL.cols - 1 - col), atol=1e-6)


def test_a_lateromedial_view_has_the_fibula_away_from_the_detector():
    other = pssf.build(KNEE, dataclasses.replace(LATERAL, projection="LM"))
    bones = {s.name: s.mesh_arrays.vertices for s in other.scene.surfaces}
    assert bones["fibula"][:, 1].mean() < bones["tibia"][:, 1].mean() - 15
    assert bones["patella"][:, 0].mean() < bones["femur"][:, 0].mean() - 30


@pytest.mark.parametrize("rotation_deg", [0.0, 1.5])
def test_a_beam_along_the_plateau_superimposes_its_margins(schuss, rotation_deg):
    protocol = dataclasses.replace(LYON, beam_angle_deg=rotation_deg)
    front, back = find_plateau_margins(schuss.assembly, extract_mesh(schuss.bones["tibia"].outer), "medial")
    depth = float(np.linalg.norm(front - back))
    # The margin nearer to the source is magnified more than the joint plane.
    assert schuss.inter_margin_mm(protocol) == pytest.approx(
        depth * np.sin(np.deg2rad(rotation_deg)), rel=0.06, abs=1e-3
    )


def test_a_radiograph_stores_its_fitted_beam_and_can_be_reproduced(schuss):
    protocol = reduce_matrix(LYON)
    one = pssf.simulate(schuss, protocol, engine="scanline", rng=2)
    assert one.protocol.beam_along == "horizontal"
    assert one.protocol == schuss.aim_beam(protocol)
    again = pssf.simulate(schuss, one.protocol, engine="scanline", rng=2)
    assert np.array_equal(one.pixels, again.pixels)
    assert one.truth == schuss.truth(protocol)


def test_a_steeper_plateau_needs_a_smaller_beam_angle(schuss):
    steep = pssf.build(dataclasses.replace(KNEE, tibial_slope_deg=KNEE.tibial_slope_deg + 3), LYON)
    less = schuss.aim_beam(LYON).beam_angle_deg - steep.aim_beam(LYON).beam_angle_deg
    # The change differs slightly from 3 degrees, because the plateau margins move to other points of the rims.
    assert 2.3 < less < 3.7


def test_a_beam_angle_that_is_not_fitted_yet_raises_an_error(schuss):
    for function in (resolve_view, lambda protocol: pssf.trace(schuss.scene, protocol)):
        with pytest.raises(
            InputError, match=r"beam_along must be 'horizontal' .*, got 'medial_plateau': use BuiltKnee\.aim_beam"
        ):
            function(LYON)
    with pytest.raises(InputError, match=r"beam_along must be .*, got 'medial_plateau'"):
        pssf.simulate(schuss.scene, reduce_matrix(LYON))


def test_a_plateau_slope_beyond_the_beam_range_raises_an_error():
    leaning = dataclasses.replace(LYON, tibia_forward_deg=45.0)
    with pytest.raises(InputError, match=r"angles of -30 and 30 deg, the plateau margins are .* mm apart"):
        pssf.build(KNEE, leaning).aim_beam(leaning)


@pytest.mark.parametrize("flexion_deg", [42.0, 60.0, 75.0])
def test_bending_a_limb_is_reversible_and_preserves_its_thickness(flexion_deg):
    bend = build_limb_bend(flexion_deg, 1.0)
    straight = np.random.default_rng(1).uniform([-60, -70, -200], [60, 70, 340], (500, 3))
    bent = bend.bend_points(straight)
    assert_allclose(bend.straighten_points(bent), straight, atol=1e-9)
    # The distance between front and back of a cross-section is unchanged.
    across = np.array([[0.0, -60.0, 0.0], [0.0, 60.0, 0.0]])
    for height in (-150.0, 0.0, 60.0, 300.0):
        front, back = bend.bend_points(across + np.array([0.0, 0.0, height]))
        assert np.linalg.norm(front - back) == pytest.approx(120.0)
    low, high = bend.bend_points(np.array([[0.0, 0.0, 250.0], [0.0, 0.0, 300.0]]))
    assert np.rad2deg(np.arctan2(high[1] - low[1], high[2] - low[2])) == pytest.approx(bend.angle_deg)


def test_shear_and_bending_angles_add_up_to_the_flexion():
    assert build_limb_bend(40.0, 1.0).angle_deg == 0
    for flexion_deg in (0.0, 22.0, 40.0, 41.0, 45.0, 60.0):
        assert shear_angle_deg(flexion_deg) + build_limb_bend(flexion_deg, 1.0).angle_deg == pytest.approx(flexion_deg)
    assert build_limb_bend(40.01, 1.0).angle_deg == pytest.approx(0.0, abs=0.1)


def test_a_limb_that_would_fold_behind_the_knee_raises_an_error():
    thick = dataclasses.replace(KNEE, limb_ap_mm=180.0, flexion_deg=15.0)
    deep = dataclasses.replace(pssf.load_protocol("rosenberg"), flexion_deg=60.0)
    with pytest.raises(InputError, match=r"would fold behind the knee.*smaller limb_ap_mm"):
        pssf.build(thick, deep)


@pytest.mark.parametrize("seed", [1])
def test_flexion_to_60_degrees_keeps_patellar_contact_and_tendon_length(seed):
    knee = pssf.sample_knee(grade=1, rng=np.random.default_rng(seed), grade_table="population")
    lengths = []
    for flexion_deg in (0.0, 60.0):
        protocol = dataclasses.replace(pssf.load_protocol("rosenberg"), flexion_deg=flexion_deg)
        built = pssf.build(knee, protocol)
        patella, femur = (built.bones[name].outer for name in ("patella", "femur"))
        assert 0.5 < patella.min_gap(femur, 20.0) < 5.0
        build, frame = built.assembly.bone_parameters, built.assembly.pose.tibia_transform()
        apex = extract_mesh(patella).vertices[
            extract_mesh(small_bones.build_patella(build).outer).vertices[:, 2].argmin()
        ]
        end = np.array(build.shape.patellar_tendon.tuberosity) * build.scale
        lengths.append(np.linalg.norm(apex - frame[:, :3] @ end - frame[:, 3]))
    assert lengths[1] == pytest.approx(lengths[0], rel=0.01)


def test_a_fitted_beam_projects_the_origin_to_the_image_centre(schuss):
    view = resolve_view(schuss.aim_beam(LYON))
    row, col = project_points(np.zeros((1, 3)), view)[0]
    assert_allclose((row, col), ((LYON.rows - 1) / 2, (LYON.cols - 1) / 2), atol=1e-6)


def test_trochlear_landmarks_are_on_the_upper_edge_of_the_femur(axial):
    protocol = reduce_matrix(SKYLINE, 2)
    truth = pssf.simulate(axial, protocol, keep=("masks",), engine="scanline").truth
    landmarks_px = {name: truth.landmarks_px[name] for name in ("trochlea_lateral", "sulcus", "trochlea_medial")}
    for row, col in landmarks_px.values():
        assert np.flatnonzero(truth.masks["femur"][:, round(col)])[0] == pytest.approx(row, abs=1.5)
    rows, cols = zip(*landmarks_px.values(), strict=True)
    assert cols == tuple(sorted(cols))
    assert rows[1] > max(rows[0], rows[2])


def test_the_slope_measured_on_a_lateral_view_follows_the_tibial_slope(side):
    steeper = pssf.build(dataclasses.replace(KNEE, tibial_slope_deg=KNEE.tibial_slope_deg + 4), LATERAL)
    slopes_deg = []
    for built in (side, steeper):
        frame, tibia = built.assembly.pose.tibia_transform(), extract_mesh(built.bones["tibia"].outer)
        slopes_deg.append(
            view_effects.medial_plateau_slope_deg(
                built.assembly, Mesh((tibia.vertices - frame[:, 3]) @ frame[:, :3], tibia.faces)
            )
        )
    # The slope is that of the medial plateau between its rims, about 1.5 deg more than the mean of both plateaus.
    assert slopes_deg[0] == pytest.approx(KNEE.tibial_slope_deg + 1.5, abs=2.0)
    # The change differs slightly from 4 degrees, because tangents touch other points of the rims.
    assert 2.5 < slopes_deg[1] - slopes_deg[0] < 5.0


def test_a_deviation_from_a_range_is_measured_from_its_nearer_end():
    known = load_reference_tables().views["inter_margin_fixed_flexion_mm"]
    rows = [
        view_effects._compare_quantity("inter_margin_fixed_flexion_mm", known, (value, 0.5), 3)
        for value in (1.0, 2.0, 3.0)
    ]
    assert [row["off"] for row in rows] == pytest.approx([1.0 - known.range[0], 0.0, 3.0 - known.range[1]])


def test_every_reference_value_of_patient_views_is_also_simulated():
    found = view_effects.measure_knee_on_views((1, KNEE), load_anatomy_tables(), beam_angle_range_deg())
    assert set(found) - set(view_effects._ALTERNATIVE_DEFINITIONS) | {"beam_along_plateau_sd_deg"} == set(
        load_reference_tables().views
    )
    assert set(view_effects._ALTERNATIVE_DEFINITIONS.values()) < set(load_reference_tables().views)
    assert found["inter_margin_missed_by_more_mm"] > found["inter_margin_lyon_schuss_mm"]
    assert found["aligned_within_more_percent"] >= found["aligned_at_11_deg_percent"]
    # Rotation moves the anterior cortex of the shaft in the image, but not its axis.
    assert found["slope_per_rotation_front_deg"] > found["slope_per_rotation_deg"]
    assert found["inter_margin_lyon_schuss_mm"] < found["inter_margin_fixed_flexion_mm"]
    assert 90 < found["sulcus_angle_deg"] < 180


@pytest.mark.slow  # Scatter is simulated by both methods.
def test_scatter_kernel_and_monte_carlo_are_compared_for_each_view():
    (row,) = view_scatter.compare_scatter_by_view(1, ("lateral",), 200_000, sampled_grades=(2,))
    assert (row["view"], row["photons"]) == ("lateral", 200_000)
    assert 40 < row["exit_gap_mm"] < 80
    assert abs(row["off_percent"]) < 30
    assert row["sampled_low_percent"] == row["sampled_high_percent"] != row["off_percent"]
    assert abs(row["off_signal_percent"]) < abs(row["off_percent"])


@pytest.mark.parametrize(
    ("name", "side_of", "orientation"),
    [("lateral", "right", ["P", "F"]), ("lateral", "left", ["A", "F"]), ("skyline", "left", ["L", "P"])],
)
def test_dicom_patient_orientation_follows_the_view(name, side_of, orientation):
    protocol = pssf.load_protocol(name)
    item = dicom_radiograph._make_anatomy_attributes(
        (dataclasses.replace(KNEE, side=side_of),), protocol, load_dicom_tables()
    )
    assert item.PatientOrientation == orientation
    assert "ViewPosition" not in item
    assert item.ViewCodeSequence[0].CodeValue == {"ML": "399260004", "axial": "399110001"}[protocol.projection]


def test_a_landmark_that_is_not_visible_in_a_view_raises_an_error(side):
    with pytest.raises(InputError, match=r"landmark must be one of joint.* in this view, got 'medial_joint_line'"):
        _ = side.truth(LATERAL).medial_joint_line_px


def test_a_sampled_bilateral_acquisition_is_not_collimated():
    sampled = pssf.sample_acquisition(pssf.load_protocol("bilateral"), rng=np.random.default_rng(1))
    assert (sampled.field_width_mm, sampled.field_height_mm) == (0, 0)
    assert sampled.knee_distance_mm == 210


def test_positioning_criteria_are_measured_on_projections(monkeypatch):
    monkeypatch.setattr(positioning_criteria, "build", build_once)
    found = positioning_criteria.measure_knee_positioning(KNEE)
    assert set(found) == set(load_reference_tables().criteria)
    rear = dataclasses.replace(KNEE, fibular_tip_mm=25.0)
    lower = positioning_criteria.measure_knee_positioning(rear)
    # A more distal fibular tip is at the level of a narrower part of the tibia.
    assert lower["ap_head_under_tibia_percent"] < found["ap_head_under_tibia_percent"]
    assert 1.2 < found["rosenberg_notch_over_ap"] < 4.0


def test_clearance_between_projections_is_scaled_to_the_joint_plane():
    view = resolve_view(pssf.load_protocol("lateral"))
    one, other = np.zeros((2, 40, 60), np.bool_)
    one[10:20, 5:15], other[12:18, 25:40] = True, True
    assert positioning_criteria._clearance_mm(one, other, view) == pytest.approx(
        11 * view.pixel_mm / magnification(view)
    )
    assert positioning_criteria._clearance_mm(one, one, view) == 0.0


def test_rotation_separates_the_condyles_on_a_lateral_view():
    protocol = pssf.load_protocol("lateral")
    view = resolve_view(protocol)
    offsets_mm = [
        positioning_criteria._condyle_offset_mm(
            build_once(dataclasses.replace(KNEE, rotation_deg=degrees), protocol), view
        )
        for degrees in (-10.0, 0.0, 10.0)
    ]
    assert offsets_mm[1] < 4.0
    assert min(offsets_mm[0], offsets_mm[2]) > offsets_mm[1]
