"""ship: the mean man's femur and tibia, made now and put into the package: `python -m pssf.anatomy.ship`."""

from ..data.anatomy import anatomy_tables
from .femur import mean_femur
from .tibia import mean_tibia


def main() -> None:
    """Make both anew, which takes seconds, instead of those that are in the package."""
    tables = anatomy_tables()
    mean_femur(tables.shape.femur, tables.forms).ship()
    mean_tibia(tables.shape.tibia, tables.forms).ship()


if __name__ == "__main__":
    main()
