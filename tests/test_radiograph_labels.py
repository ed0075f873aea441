"""Labels of a radiograph: joint space, landmarks and masks."""

import dataclasses

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold
from numpy.testing import assert_allclose

import pssf
from pssf import anatomy, raycast
from pssf.anatomy.labels.osteophyte_faces import _split_faces_by_site
from pssf.anatomy.labels.radiograph_labels import _split_by_site
from pssf.anatomy.outlines.projected_contours import COMPARTMENT_RANGE
from pssf.core.label_names import TIBIAL_LANDMARKS
from pssf.geometry.mesh import Mesh
from pssf.geometry.view import magnification, project_points, resolve_view

REFERENCE = pssf.load_protocol("reference")
BEAKS = tuple(pssf.Osteophyte(site=site, size_mm=2.0) for site in ("medial_femur", "medial_tibia", "lateral_spine"))


@pytest.fixture(scope="module")
def grown():
    knee = pssf.Knee(osteophytes=BEAKS)
    small = dataclasses.replace(REFERENCE, rows=512, cols=512, pixel_mm=0.3)
    return pssf.simulate(knee, small, engine="scanline", keep=("masks",))


FRONTAL = ("reference", "ap_standing", "caudal_beam", "fixed_flexion", "geometry_shift", "lyon_schuss", "rosenberg")


def measure_gap_on_contours(built, protocol, truth, side):
    """Measure the minimum joint space from projected triangles, or from tibial landmarks."""
    view = resolve_view(protocol)
    middle = project_points(np.zeros((1, 3)), view)[0]
    lean = np.deg2rad(built.assembly.pose.lean_deg * (1 if built.knee.side == "right" else -1))
    upright = np.array([[np.cos(lean), -np.sin(lean)], [np.sin(lean), np.cos(lean)]])
    half, medial = built.assembly.bone_parameters.half_ml_mm, 1 if built.knee.side == "right" else -1
    sign = medial if side == "medial" else -medial
    ends = [project_points(np.array([[sign * part * half, 0.0, 0.0]]), view)[0, 1] for part in COMPARTMENT_RANGE]
    columns = np.arange(np.ceil(min(ends)), np.floor(max(ends)) + 1)

    def rotate(points_px):
        return (np.asarray(points_px) - middle) @ upright.T + middle

    def find_outline(name, lowest):
        surface = next(one for one in built.scene.surfaces if one.name == name)
        triangles = rotate(project_points(surface.mesh_arrays.vertices, view))[surface.mesh_arrays.faces]
        found = []
        for column in columns:
            part = triangles[(triangles[:, :, 1].min(axis=1) <= column) & (triangles[:, :, 1].max(axis=1) >= column)]
            start, stop = part, np.roll(part, 1, axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                fraction = (column - start[..., 1]) / (stop[..., 1] - start[..., 1])
                rows = start[..., 0] + fraction * (stop[..., 0] - start[..., 0])
            rows = rows[(fraction >= 0) & (fraction <= 1)]
            found.append(rows.max() if lowest else rows.min())
        return np.array(found)

    if built.knee.jsw_definition == "projected":
        tibia = find_outline("tibia", False)
    else:
        points = rotate([truth.landmarks_px[name] for name in TIBIAL_LANDMARKS])
        points = points[points[:, 1].argsort()]
        tibia = np.interp(columns, points[:, 1], points[:, 0])
    return float((tibia - find_outline("femur", True)).min() * protocol.pixel_mm / magnification(view))


@settings(max_examples=4, deadline=None)
@given(
    view=st.sampled_from(FRONTAL),
    table=st.sampled_from([("paper", 2), ("population", 4)]),
    grade=st.integers(0, 4),
    seed=st.integers(0, 2**32),
    varied=st.booleans(),
)
def test_joint_space_labels_equal_the_projected_gaps(view, table, grade, seed, varied):
    rng = np.random.default_rng(seed)
    knee = pssf.sample_knee(grade=min(grade, table[1]), rng=rng, grade_table=table[0])
    protocol = pssf.load_protocol(view)
    if varied:
        protocol = pssf.sample_acquisition(protocol, rng=rng)
    built = pssf.build(knee, protocol)
    protocol = built.aim_beam(protocol)
    truth = built.truth(protocol)
    for side in ("medial", "lateral"):
        label = getattr(truth, f"jsw_{side}_mm")
        assert label == pytest.approx(measure_gap_on_contours(built, protocol, truth, side), abs=0.05)
        (top, _), (bottom, _) = (truth.landmarks_px[f"{side}_jsw_{bone}"] for bone in ("femur", "tibia"))
        lean = np.deg2rad(built.assembly.pose.lean_deg)
        landmark_mm = (bottom - top) * protocol.pixel_mm / magnification(resolve_view(protocol)) / np.cos(lean)
        assert label == pytest.approx(landmark_mm, abs=0.01)


def test_jsw_labels_equal_specified_jsw_in_the_defining_protocol(knee, built):
    truth = built.truth(REFERENCE)
    for fraction, space in truth.jsw_at_mm.items():
        least = knee.jsw_medial_mm if fraction < 0.5 else knee.jsw_lateral_mm
        assert least - 1e-3 <= space < least + 4
    assert truth.jsw_medial_mm == pytest.approx(knee.jsw_medial_mm, abs=1e-3)
    assert truth.jsw_lateral_mm == pytest.approx(knee.jsw_lateral_mm, abs=1e-3)


def test_jsw_at_fixed_locations_is_consistent_with_the_minimum_jsw():
    protocol = pssf.load_protocol("fixed_flexion")
    off = {"medial": [], "lateral": []}
    for seed in range(3):
        knee = pssf.sample_knee(grade=seed % 4, rng=seed, grade_table="population", subluxation_mm=0.0)
        varied = pssf.sample_acquisition(protocol, rng=seed)
        truth = pssf.build(knee, varied).truth(varied)
        for side, of_side in (("medial", slice(0, 7)), ("lateral", slice(7, 16))):
            least = getattr(truth, f"jsw_{side}_mm")
            off[side].append(min(list(truth.jsw_at_mm.values())[of_side]) - least)
            assert least != pytest.approx(getattr(knee, f"jsw_{side}_mm"), abs=1e-3)
    # JSW(x) is sampled every 2 mm: its minimum may be slightly above JSW, or below it at more peripheral locations.
    for beyond in off.values():
        assert min(beyond) > -0.3
        assert np.median(beyond) < 0.3


@pytest.mark.parametrize("view", ["lateral", "skyline"])
def test_views_without_a_visible_joint_space_have_no_jsw_labels(view):
    protocol = dataclasses.replace(pssf.load_protocol(view), rows=64, cols=64, pixel_mm=4.8)
    truth = pssf.build(pssf.Knee(), protocol).truth(protocol)
    assert (truth.jsw_medial_mm, truth.jsw_lateral_mm, truth.jsw_at_mm) == (None, None, {})


def test_older_files_with_labels_of_another_view_give_a_warning(grown, tmp_path):
    names = ("medial_jsw_femur", "medial_jsw_tibia", "lateral_jsw_femur", "lateral_jsw_tibia")
    landmarks_px = {name: point for name, point in grown.truth.landmarks_px.items() if name not in names}
    old = dataclasses.replace(grown.truth, landmarks_px=landmarks_px, jsw_medial_mm=9.0)
    path = pssf.save(dataclasses.replace(grown, truth=old), tmp_path / "old.tif")
    with pytest.warns(UserWarning, match="written by an earlier version"):
        truth = pssf.load(path).truth
    assert (truth.jsw_medial_mm, truth.jsw_lateral_mm, truth.jsw_at_mm) == (None, None, {})


def test_landmarks_have_the_anatomical_arrangement_and_size(grown):
    landmarks_px = grown.truth.landmarks_px
    mm = grown.protocol.pixel_mm / magnification(resolve_view(grown.protocol))
    row, col = ({name: point[k] for name, point in landmarks_px.items()} for k in (0, 1))
    for name in ("condyle_edge", "plateau_edge", "epicondyle", "spine", "joint_line"):
        assert col[f"medial_{name}"] > col["joint_centre"] > col[f"lateral_{name}"]
    assert row["medial_epicondyle"] < row["medial_condyle_edge"] < row["medial_joint_line"] < row["medial_plateau_edge"]
    assert row["notch"] < row["lateral_spine"] < row["joint_centre"]
    assert_allclose((col["medial_plateau_edge"] - col["lateral_plateau_edge"]) * mm, 77.5, atol=2.0)
    assert_allclose((col["medial_epicondyle"] - col["lateral_epicondyle"]) * mm, 82.65, atol=3.0)


def test_masks_are_the_projections_of_the_bones(grown):
    masks = grown.truth.masks
    bones = set(anatomy.BONES) - {"fabella"}
    assert set(masks) == {*bones, *(f"{beak.site}_osteophyte" for beak in BEAKS)}
    scene = pssf.build(grown.knee).scene
    for name in bones:
        surface = next(s for s in scene.surfaces if s.name == name)
        paths = pssf.trace(pssf.Scene([surface], "muscle"), grown.protocol, engine="scanline", precision="float64")
        assert ((paths.path_mm["cortical_bone"] > 0) == masks[name]).mean() > 0.9999


def test_an_osteophyte_mask_extends_beyond_the_plateau_by_its_size(grown):
    landmarks_px, masks = grown.truth.landmarks_px, grown.truth.masks
    mm = grown.protocol.pixel_mm / magnification(resolve_view(grown.protocol))
    cols = np.flatnonzero(masks["medial_tibia_osteophyte"].any(axis=0))
    assert_allclose((cols.max() - landmarks_px["medial_plateau_edge"][1]) * mm, 2.0, atol=0.4)
    bone = masks["tibia"] | masks["femur"]
    for beak in BEAKS:
        mask = masks[f"{beak.site}_osteophyte"]
        assert 10 < mask.sum() < 1000
        assert (bone[mask]).all()
    assert not (masks["medial_tibia_osteophyte"] & masks["lateral_spine_osteophyte"]).any()


def test_merged_osteophytes_of_two_sites_are_split_between_their_tips():
    box, far = Manifold.cube((10.0, 2.0, 2.0)), Manifold.cube((3.0, 2.0, 2.0)).translate((30.0, 0.0, 0.0))
    tips = np.array([[1.0, 1.0, 1.0], [4.0, 1.0, 1.0], [8.0, 1.0, 1.0], [40.0, 1.0, 1.0]])
    sites = ["medial_spine", "medial_spine", "lateral_spine", "medial_tibia"]
    volumes = {site: part.volume() for site, part in _split_by_site(box + far, sites, tips).items()}
    assert volumes == pytest.approx({"medial_spine": 4 * 6.0, "lateral_spine": 4 * 4.0, "medial_tibia": 12.0})


def test_masks_of_a_left_knee_mirror_those_of_a_right_knee(grown):
    left = dataclasses.replace(grown.knee, side="left")
    for site, mesh in pssf.build(left).osteophyte_meshes().items():
        assert mesh.as_trimesh().volume > 0
        silhouette = raycast.compute_silhouette(mesh, grown.protocol)
        assert (silhouette[:, ::-1] == grown.truth.masks[f"{site}_osteophyte"]).mean() > 0.9999


@pytest.mark.parametrize("grade", [2, 3, 4])
def test_osteophyte_masks_agree_with_the_silhouettes_of_the_added_bone(grade):
    protocol = pssf.load_protocol("fixed_flexion").resample(1024)
    built = pssf.build(pssf.sample_knee(grade=grade, rng=10 * grade), protocol)
    protocol = built.aim_beam(protocol)
    faces, solids = built.mask_meshes(), built.osteophyte_meshes()
    assert solids
    for site, solid in solids.items():
        # The osteophytes are far from the cut ends of the shafts.
        assert np.abs(solid.vertices[:, 2]).max() < 80
        mask = raycast.compute_face_silhouette(faces[f"{site}_osteophyte"], resolve_view(protocol))
        silhouette = raycast.compute_silhouette(solid, protocol)
        assert (mask != silhouette).sum() <= 3 + 0.05 * silhouette.sum(), site


def test_surgery_changes_only_the_masks_of_osteophytes_that_it_cuts(built):
    tip_mm = built.osteophyte_meshes()["medial_tibia"].vertices.mean(axis=0)
    box = trimesh.creation.box((8.0, 8.0, 8.0)).apply_translation(tip_mm)
    before, after = built.mask_meshes(), built.resect(box).mask_meshes()
    for name in ("lateral_femur_osteophyte", "medial_tibia_osteophyte"):
        same = name in after and np.array_equal(before[name].vertices, after[name].vertices)
        assert same == name.startswith("lateral")


def test_faces_of_merged_osteophytes_are_split_between_their_tips():
    # The tips of two sites are in the first box; the second box is nearest to the tip of a third site.
    box = trimesh.creation.box((10.0, 2.0, 2.0)).apply_translation((5.0, 1.0, 1.0))
    far = trimesh.creation.box((3.0, 2.0, 2.0)).apply_translation((31.5, 1.0, 1.0))
    both = trimesh.util.concatenate([box, far])
    tips = np.array([[1.0, 1.0, 1.0], [4.0, 1.0, 1.0], [8.0, 1.0, 1.0], [40.0, 1.0, 1.0]])
    sites = ["medial_spine", "medial_spine", "lateral_spine", "medial_tibia"]
    parts = _split_faces_by_site(Mesh(both.vertices, both.faces), sites, tips)
    ends = {site: (mesh.vertices[:, 0].min(), mesh.vertices[:, 0].max()) for site, mesh in parts.items()}
    expected = {"medial_spine": (0.0, 6.0), "lateral_spine": (6.0, 10.0), "medial_tibia": (30.0, 33.0)}
    assert ends == {site: pytest.approx(range_mm) for site, range_mm in expected.items()}


def test_masks_are_made_only_on_request_and_only_for_a_knee(built, scene):
    small = dataclasses.replace(REFERENCE, rows=32, cols=32, pixel_mm=5.0)
    assert not pssf.simulate(built, small).truth.masks
    with pytest.raises(pssf.InputError, match="keep must not contain masks for a Scene"):
        pssf.simulate(scene, small, keep=("masks",))


def test_truth_is_loaded_unchanged_from_a_file(grown, tmp_path):
    assert pssf.load(pssf.save(grown, tmp_path / "knee.tif")).truth == grown.truth


@pytest.mark.parametrize(("rows", "cols", "pixel_mm"), [(64, 64, 30.0), (12, 12, 25.0), (1, 1, 1.0), (2, 3, 50.0)])
def test_landmarks_do_not_depend_on_very_coarse_pixels(built, small, rows, cols, pixel_mm):
    fine = built.truth(small)
    coarse = dataclasses.replace(small, rows=rows, cols=cols, pixel_mm=pixel_mm)
    truth = built.truth(coarse)
    for name, point in fine.landmarks_px.items():
        fine_mm, coarse_mm = (
            [
                (at - (count - 1) / 2) * protocol.pixel_mm
                for at, count in zip(spot, (protocol.rows, protocol.cols), strict=True)
            ]
            for spot, protocol in ((point, small), (truth.landmarks_px[name], coarse))
        )
        np.testing.assert_allclose(coarse_mm, fine_mm, atol=1.0)
