"""Trabecular bone that leaves a thin cortex is drawn in where it does, and nowhere else."""

import numpy as np
import pytest
from manifold3d import Manifold
from numpy.testing import assert_allclose

from pssf.anatomy.bones.bone_shells import Bone
from pssf.anatomy.bones.shell_checks import check_nesting, is_nested, repair_nesting
from pssf.anatomy.meshing.solids import extract_mesh
from pssf.core.checks import InputError
from pssf.geometry.mesh_containment import is_mesh_within

OUTER = Manifold.sphere(20.0, 96)
INNER = Manifold.sphere(19.0, 96)
LATERAL = (20.0, 0.0, 0.0)


def with_folds(*places: tuple[float, float, float], size_mm: float = 0.4) -> Bone:
    """Shells whose inner one has a pin through the outer one at places on it."""
    inner = INNER
    for place in places:
        inner += Manifold.batch_hull([Manifold.sphere(size_mm, 24).translate(np.array(place) * at) for at in (0.94, 1)])
    return Bone(outer=OUTER, inner=inner)


@pytest.mark.parametrize("places", [[LATERAL], [LATERAL, (0.0, -20.0, 0.0), (0.0, 0.0, 20.0)]])
def test_a_fold_is_drawn_in_where_it_is(places):
    bone = with_folds(*places)
    assert not is_nested(bone)
    inner = repair_nesting("tibia", bone).inner
    assert is_mesh_within(extract_mesh(inner), extract_mesh(bone.outer))
    assert (inner - bone.outer).volume() == 0.0
    # No deeper than the pins stand out of the inner shell, and by nothing elsewhere.
    assert_allclose((INNER - inner).volume(), 0.0, atol=1e-9)
    # It keeps clear of the outer surface by what it is drawn in by, along each axis.
    assert_allclose(np.abs(extract_mesh(inner).vertices).max(), 20.0 - 0.1, atol=0.02)


def test_shells_that_nest_are_left_as_they_are():
    bone = Bone(outer=OUTER, inner=INNER)
    assert is_nested(bone)
    assert repair_nesting("tibia", bone) is bone


def test_what_is_no_fold_is_refused():
    with pytest.raises(InputError, match=r"trabecular bone of the tibia must be inside the solid around it, got"):
        repair_nesting("tibia", with_folds(LATERAL, size_mm=4.0))


def test_bones_that_meet_and_shells_that_leave_are_refused():
    bone, muscle = Bone(outer=OUTER, inner=INNER), Manifold.sphere(60.0, 48)
    check_nesting({"femur": bone}, muscle)
    near = Bone(outer=OUTER.translate((39.0, 0.0, 0.0)), inner=INNER.translate((39.0, 0.0, 0.0)))
    with pytest.raises(InputError, match=r"femur and tibia must not overlap, got .* mm3 of overlap: "):
        check_nesting({"femur": bone, "tibia": near}, muscle)
    with pytest.raises(InputError, match=r"cortex of the femur must be inside the solid around it"):
        check_nesting({"femur": bone}, Manifold.sphere(19.5, 48))
    outside = Bone(outer=OUTER, inner=INNER, canal=Manifold.sphere(19.5, 48))
    with pytest.raises(InputError, match=r"marrow of the femur must be inside the solid around it"):
        check_nesting({"femur": outside}, muscle)
