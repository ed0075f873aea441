"""Command that builds the template bones and stores them in the package.

Run ``python -m pssf.anatomy.template.export_template`` after a change of the template tables or of the code that
meshes them.
"""

from ...data.anatomy.anatomy_tables import load_anatomy_tables
from .template_femur import make_template_femur
from .template_tibia import make_template_tibia


def main() -> None:
    """Build the template femur and tibia, which takes seconds, and replace those in the package."""
    tables = load_anatomy_tables()
    make_template_femur(tables.template.femur, tables.shape_model).write_to_package()
    make_template_tibia(tables.template.tibia, tables.shape_model).write_to_package()


if __name__ == "__main__":
    main()
