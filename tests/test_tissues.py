import pytest
from manifold3d import Manifold

from pssf.anatomy.tissues import _without


def box(side_mm, x_mm=0.0):
    return Manifold.cube((side_mm,) * 3, center=True).translate((x_mm, 0.0, 0.0))


def test_a_piece_that_bones_alone_bound_stays_with_the_solid_it_lies_within():
    shell = box(6.0, 20.0) - box(2.0, 20.0)
    near, far = _without([box(10.0), box(10.0, 20.0)], [shell])
    assert near.volume() == pytest.approx(1000)
    assert far.volume() == pytest.approx(1000 - 6**3 + 2**3)
