"""Check the shape model: lattice fits, modes, shape table and resulting bones."""

import dataclasses
import tomllib

import msgspec
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from tools.bone_frames import (
    apply_standing_pose,
    build_template_anatomy,
    build_template_bones,
    undo_standing_pose,
)
from tools.lattice_fit import fit_lattice, make_deformable_bone, make_lattice_around
from tools.mode_names import ModeName, name_modes
from tools.shape_modes import (
    MeanFit,
    compute_displacements,
    compute_modes,
    fit_mean,
    fit_scores,
    surface_change_mm,
)
from tools.shape_table_fit import format_shape_table

from pssf.anatomy.template.bone_form import build_shape_model
from pssf.core.checks import InputError
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables
from pssf.data.anatomy.shape_table import (
    ShapeModel,
    format_displacements,
    load_shape_model,
    parse_displacements,
)
from pssf.data.table_records import parse_record
from pssf.geometry.freeform_deformation import displace_points, min_jacobian_determinant, replace_displacements
from pssf.geometry.mesh import Mesh
from pssf.patient_comparison.bones.bone_comparison import BONES
from pssf.patient_comparison.bones.shape_measures import measure_femur, measure_patella, measure_tibia
from pssf.patient_comparison.bones.surface_distance import measure_surface_distance, sample_surface

EVERYWHERE = (-np.inf, np.inf)


@pytest.fixture(scope="module")
def form():
    return build_shape_model(load_shape_model())


def make_pebble(detail=4):
    """Make an asymmetric closed body about 50 mm long."""
    ball = trimesh.creation.icosphere(detail)
    x, y, z = ball.vertices.T
    radius = 20 + 4 * x * y + 3 * z**3 + 2.5 * x**2 - 2 * np.sin(3 * y)
    return Mesh(ball.vertices * radius[:, None] * [1.2, 0.8, 1.0], np.asarray(ball.faces))


def make_known_lattice(lattice, amount_mm, seed=0):
    """Return a copy of a lattice with known smooth displacements."""
    nodes = np.stack(np.meshgrid(*(np.linspace(-1, 1, n) for n in lattice.counts), indexing="ij"), axis=-1)
    waves = np.random.default_rng(seed).normal(0, 1.2, (3, 3))
    return replace_displacements(lattice, amount_mm * np.sin(nodes @ waves + [0.3, 1.0, -0.5]))


def make_mean_fit():
    """Make a mean fit with three pebbles instead of the bones of a knee."""
    bone = make_deformable_bone(make_pebble(3), EVERYWHERE)
    lattice = make_lattice_around(bone, 20.0, 0)
    template = build_template_anatomy(load_anatomy_tables())
    return MeanFit(
        bones=dict.fromkeys(BONES, bone),
        lattices=dict.fromkeys(BONES, lattice),
        frames={},
        patient_means={},
        template=template,
    )


def make_two_mode_displacements(mean, knees=12):
    """Make displacements of knees that vary along two directions, and their scores."""
    rng = np.random.default_rng(5)
    scores = rng.normal(size=(knees, 2))
    fitted = {}
    for name in BONES:
        still = mean.lattices[name]
        one, two = (make_known_lattice(still, 1.5 - 0.7 * k, seed=k).displacements_mm.reshape(-1, 3) for k in (0, 1))
        fitted[name] = 0.2 * one + scores[:, :1, None] * one + scores[:, 1:, None] * two
    return fitted, scores


def test_lattice_fit_recovers_a_known_deformation_within_sampling_error():
    bone = make_pebble()
    ready = make_deformable_bone(bone, EVERYWHERE)
    still = make_lattice_around(ready, 18.0, 0)
    target = sample_surface(Mesh(displace_points(bone.vertices, make_known_lattice(still, 2.5)), bone.faces))
    before = measure_surface_distance(ready.apply_lattice(still), target)
    found = fit_lattice(ready, target, still)
    after = measure_surface_distance(ready.apply_lattice(found), target)
    assert before.rms_mm > 1.0
    # The sagitta of 3 mm triangles on a radius of 15 mm is 3^2 / (8 x 15) = 0.08 mm.
    assert after.rms_mm < 0.08
    assert min_jacobian_determinant(found) > 0.3


def test_lattice_fit_does_not_move_a_bone_that_already_agrees():
    ready = make_deformable_bone(make_pebble(), EVERYWHERE)
    found = fit_lattice(ready, sample_surface(make_pebble()), make_lattice_around(ready, 18.0, 0), (0.1, 0.01))
    assert np.abs(displace_points(ready.vertices, found) - ready.vertices).max() < 0.01


def test_stiffer_lattice_fits_deform_less():
    ready = make_deformable_bone(make_pebble(3), EVERYWHERE)
    still = make_lattice_around(ready, 18.0, 0)
    target = sample_surface(
        Mesh(displace_points(make_pebble().vertices, make_known_lattice(still, 2.5)), make_pebble().faces)
    )
    stiff, soft = (fit_lattice(ready, target, still, (weight,)) for weight in (1.0, 0.003))
    bending = [np.abs(np.diff(one.displacements_mm, 2, axis=0)).mean() for one in (stiff, soft)]
    assert bending[0] < bending[1]
    distances = [measure_surface_distance(ready.apply_lattice(one), target).rms_mm for one in (stiff, soft)]
    assert distances[0] > distances[1]


def test_undoing_and_applying_the_standing_pose_restores_points():
    template = build_template_anatomy(load_anatomy_tables())
    points = np.random.default_rng(0).uniform([-40, -35, -100], [40, 35, 100], (300, 3))
    for name in BONES:
        assert_allclose(
            apply_standing_pose(undo_standing_pose(points, name, template), name, template), points, atol=1e-9
        )


def test_shape_modes_recover_the_scores_that_generated_them():
    mean = make_mean_fit()
    fitted, scores = make_two_mode_displacements(mean)
    modes = compute_modes(fitted, mean)
    assert len(modes.variance_fraction) == 2
    assert_allclose(modes.variance_fraction.sum(), 1.0, atol=1e-9)
    assert_allclose(modes.scores.mean(axis=0), 0.0, atol=1e-9)
    assert_allclose(modes.scores.std(axis=0, ddof=1), 1.0, rtol=1e-9)
    # The recovered scores equal the true scores except for rotation and scale.
    off = scores - scores.mean(axis=0)
    assert_allclose(modes.scores @ np.linalg.lstsq(modes.scores, off, rcond=None)[0], off, atol=1e-9)
    for name in BONES:
        again = [compute_displacements(modes, name, one) for one in modes.scores]
        assert_allclose(again, fitted[name], atol=1e-9)
    assert_allclose(fit_scores(fitted, modes, mean), modes.scores, atol=1e-6)


def test_the_rms_of_a_mode_is_its_surface_displacement():
    mean = make_mean_fit()
    modes = compute_modes(make_two_mode_displacements(mean)[0], mean)
    for name in BONES:
        change = surface_change_mm(modes.directions[name], mean, name)
        assert_allclose(np.sqrt((change**2).mean(axis=1)), modes.rms_mm[name])


def test_modes_have_unique_names_and_increase_their_measure():
    mean = make_mean_fit()
    modes = compute_modes(make_two_mode_displacements(mean)[0], mean)
    values = np.column_stack((-2.0 * modes.scores[:, 0], modes.scores[:, 0] + 3.0 * modes.scores[:, 1]))
    oriented, named = name_modes(modes, ("height", "width"), values)
    assert [one.name for one in named] == ["height", "width"]
    assert_allclose(oriented.scores[:, 0], -modes.scores[:, 0])
    assert_allclose(oriented.directions["femur"][0], -modes.directions["femur"][0])
    assert_allclose(oriented.scores[:, 1], modes.scores[:, 1])
    assert named[0].correlation > 0.999
    assert named[1].other_measures == ""


def test_a_written_shape_table_is_read_unchanged():
    mean = make_mean_fit()
    modes = compute_modes(make_two_mode_displacements(mean)[0], mean)
    names = [ModeName(name=name, correlation=0.5, other_measures="") for name in ("one", "two")]
    text = format_shape_table(mean, modes, names, 'a "source"', "free")
    table = parse_record(ShapeModel, tomllib.loads(text), "shapes")
    assert table.source == 'a "source"'
    found = build_shape_model(table).bones["tibia"]
    shape = found.mean.displacements_mm.shape
    assert_allclose(found.mean.displacements_mm, modes.means["tibia"].reshape(shape), atol=0.005 + 1e-9)
    assert_allclose(found.modes_mm, modes.directions["tibia"].reshape(2, *shape), atol=0.0005 + 1e-9)
    assert text == format_shape_table(mean, modes, names, 'a "source"', "free")


def test_displacements_are_restored_from_text_within_rounding():
    values = np.random.default_rng(0).normal(0, 3, (3, 4, 5, 3))
    text = format_displacements(values, 2)
    assert len(text.splitlines()) == 12
    assert_allclose(parse_displacements(text, (3, 4, 5), "t"), values, atol=0.005 + 1e-12)
    with pytest.raises(ValueError, match="must contain 189 finite numbers, got 180"):
        parse_displacements(text, (3, 7, 3), "t")
    with pytest.raises(ValueError, match="must contain only numbers, got"):
        parse_displacements(text.replace("\n", " x\n"), (3, 4, 5), "t")


def test_zero_scores_give_the_mean_and_modes_add_linearly(form):
    count = len(form.modes)
    for bone in form.bones.values():
        rest = bone.build_lattice(np.zeros(count))
        assert_allclose(rest.displacements_mm, bone.mean.displacements_mm)
        scores = np.arange(count) - 3.0
        added = bone.build_lattice(scores).displacements_mm - rest.displacements_mm
        each = sum(score * mode for score, mode in zip(scores, bone.modes_mm, strict=True))
        assert_allclose(added, each, atol=1e-12)
        with pytest.raises(InputError, match="scores must have shape"):
            bone.build_lattice(np.zeros(count + 1))


def test_no_bone_folds_at_3_sd_of_any_mode_or_in_sampled_knees(form):
    count = len(form.modes)
    sampled = np.clip(np.random.default_rng(1).standard_normal((60, count)), -3, 3)
    for bone in form.bones.values():
        for scores in (*(3 * np.eye(count)), *(-3 * np.eye(count)), *sampled):
            assert min_jacobian_determinant(bone.build_lattice(scores)) > 0.1


def test_modes_are_sorted_have_unique_names_and_explain_99_percent(form):
    fractions = [mode.share for mode in form.modes]
    assert fractions == sorted(fractions, reverse=True)
    assert 0.99 <= sum(fractions) < 1.0
    assert sum(fractions[:-1]) < 0.99
    assert len({mode.name for mode in form.modes}) == len(fractions)
    assert all(mode.correlation > 0 for mode in form.modes)


def test_the_mean_shape_has_the_tibial_width_of_the_template(form):
    built = build_template_bones(build_template_anatomy(load_anatomy_tables()))["tibia"].vertices
    formed = displace_points(built, form.bones["tibia"].mean)
    widths = [np.ptp(points[points[:, 2] > points[:, 2].max() - 25][:, 0]) for points in (built, formed)]
    assert_allclose(widths[1], widths[0], atol=0.5)


def test_shape_measures_change_with_the_geometry_of_a_bone(form):
    bones = {
        name: displace_points(bone.vertices, form.bones[name].mean)
        for name, bone in build_template_bones(build_template_anatomy(load_anatomy_tables())).items()
    }
    deeper = measure_femur(bones["femur"] * [1.0, 1.05, 1.0])["femoral condyles' depth over width"]
    assert_allclose(deeper, 1.05 * measure_femur(bones["femur"])["femoral condyles' depth over width"], rtol=1e-9)
    tilted = bones["tibia"].copy()
    tilted[:, 2] -= np.tan(np.deg2rad(3.0)) * tilted[:, 1]
    for measure in ("medial plateau's fall backwards", "lateral plateau's fall backwards"):
        # The set of plateau vertices changes slightly with the tilt.
        assert_allclose(measure_tibia(tilted)[measure] - measure_tibia(bones["tibia"])[measure], 3.0, atol=1.0)
    taller = measure_patella(bones["patella"] * [1.0, 1.0, 1.1])["patella's height over width"]
    assert_allclose(taller, 1.1 * measure_patella(bones["patella"])["patella's height over width"], rtol=1e-9)


def test_a_shape_table_with_missing_or_unknown_entries_raises_an_error():
    table = load_shape_model()
    short = msgspec.structs.replace(table, modes=table.modes[:-1])
    with pytest.raises(ValueError, match=f"femur must have {len(table.modes) - 1} modes, got {len(table.modes)}"):
        build_shape_model(short)
    with pytest.raises(ValueError, match="table shapes"):
        parse_record(ShapeModel, msgspec.to_builtins(table) | {"more": 1}, "shapes")


def test_a_shape_fit_without_patellae_raises_an_error():
    with pytest.raises(InputError, match="every knee, got no patella"):
        fit_mean({"femur": [make_pebble(2)], "tibia": [make_pebble(2)]}, load_anatomy_tables())


def test_a_lattice_around_a_bone_covers_all_vertices_of_the_bone():
    bone = make_deformable_bone(make_pebble(), EVERYWHERE)
    lattice = make_lattice_around(bone, 18.0, 0)
    uniform = replace_displacements(lattice, np.broadcast_to([1.0, 2.0, 3.0], lattice.displacements_mm.shape))
    assert_allclose(
        displace_points(bone.vertices, uniform) - bone.vertices, np.tile([1.0, 2.0, 3.0], (len(bone.vertices), 1))
    )
    assert dataclasses.asdict(lattice)["pitch_mm"] == 18.0
