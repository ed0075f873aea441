"""Check the repair of nested shells: trabecular bone that crosses the cortex is moved inwards locally."""

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


def make_bone_with_folds(*positions_mm: tuple[float, float, float], size_mm: float = 0.4) -> Bone:
    """Make a bone whose inner shell has pins through the outer shell at given positions."""
    inner = INNER
    for position in positions_mm:
        inner += Manifold.batch_hull(
            [Manifold.sphere(size_mm, 24).translate(np.array(position) * at) for at in (0.94, 1)]
        )
    return Bone(outer=OUTER, inner=inner)


@pytest.mark.parametrize("positions_mm", [[LATERAL], [LATERAL, (0.0, -20.0, 0.0), (0.0, 0.0, 20.0)]])
def test_a_fold_of_the_inner_shell_is_moved_inwards_only_locally(positions_mm):
    bone = make_bone_with_folds(*positions_mm)
    assert not is_nested(bone)
    inner = repair_nesting("tibia", bone).inner
    assert is_mesh_within(extract_mesh(inner), extract_mesh(bone.outer))
    assert (inner - bone.outer).volume() == 0.0
    # Only the pins are removed; the rest of the inner shell is unchanged.
    assert_allclose((INNER - inner).volume(), 0.0, atol=1e-9)
    # The clearance to the outer surface is the repair distance along each axis.
    assert_allclose(np.abs(extract_mesh(inner).vertices).max(), 20.0 - 0.1, atol=0.02)


def test_correctly_nested_shells_are_not_changed():
    bone = Bone(outer=OUTER, inner=INNER)
    assert is_nested(bone)
    assert repair_nesting("tibia", bone) is bone


def test_a_fold_that_is_too_large_to_repair_raises_an_error():
    with pytest.raises(InputError, match=r"trabecular bone of the tibia must be inside the solid around it, got"):
        repair_nesting("tibia", make_bone_with_folds(LATERAL, size_mm=4.0))


def test_overlapping_bones_and_protruding_shells_raise_an_error():
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
