"""Materials by name, as a technique has them."""

from pssf.data.anatomy.tissue_table import load_tissues
from pssf.geometry.scene import Scene
from pssf.validation.imaging import scatter_phantoms
from pssf.xray.materials import Material, attenuation_per_mm, resolve_material


def material(name: str) -> Material:
    """The material that a name stands for."""
    return resolve_material(name, load_tissues())


def limb(thick_mm: float) -> Scene:
    """An elliptic limb of tissues by name."""
    return scatter_phantoms.build_limb(thick_mm, load_tissues())


def attenuation(name, energies_kev):
    """Of the material that a name stands for, 1/mm at each energy."""
    return attenuation_per_mm(material(name), energies_kev)
