"""All anatomy tables for building a knee, in one record."""

from functools import cache

from ..table_records import Record
from .bone_tables import TemplateAnatomy, load_template_anatomy
from .shape_table import ShapeModel, load_shape_model
from .trabecular_table import TrabecularBone, load_trabecular_bone


class AnatomyTables(Record, frozen=True):
    """Anatomy tables for building a knee.

    Attributes
    ----------
    template : TemplateAnatomy
        Shape of the template anatomy: bones and soft tissue.
    shape_model : ShapeModel
        Statistical shape model of the bones.
    trabecular_bone : TrabecularBone
        Density of trabecular bone, and the lattice of its struts.
    """

    template: TemplateAnatomy
    shape_model: ShapeModel
    trabecular_bone: TrabecularBone


@cache
def load_anatomy_tables() -> AnatomyTables:
    """Load all tables of the anatomy.

    Returns
    -------
    AnatomyTables
        Anatomy tables of the package.
    """
    return AnatomyTables(
        template=load_template_anatomy(), shape_model=load_shape_model(), trabecular_bone=load_trabecular_bone()
    )
