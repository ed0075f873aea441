"""AnatomyTables: all that bones are built from, read together at the door of the anatomy."""

from functools import cache

from .bones import BoneShape, mean_shape
from .records import Record
from .shapes import ShapeTable, shape_table
from .spongy import TrabecularBone, trabecular_bone


class AnatomyTables(Record, frozen=True):
    """What a knee is built from.

    shape   of the mean man's bones, and what lies about them
    forms   how people's bones differ from his
    spongy  how much trabecular bone there is where, and its lattice
    """

    shape: BoneShape
    forms: ShapeTable
    spongy: TrabecularBone


@cache
def anatomy_tables() -> AnatomyTables:
    """The package's tables."""
    return AnatomyTables(shape=mean_shape(), forms=shape_table(), spongy=trabecular_bone())
