"""Command that builds the template bones and stores their meshes in the package.

Run ``python -m tools.export_template`` in the folder ``tests`` after a change of the template tables or the meshing
code.
"""

from pssf.anatomy.template.template_femur import make_template_femur
from pssf.anatomy.template.template_tibia import make_template_tibia
from pssf.data.anatomy.anatomy_tables import load_anatomy_tables


def main() -> None:
    """Build the template femur and tibia, and replace their files in the package."""
    tables = load_anatomy_tables()
    make_template_femur(tables.template.femur, tables.shape_model).write_to_package()
    make_template_tibia(tables.template.tibia, tables.shape_model).write_to_package()


if __name__ == "__main__":
    main()
