"""Materials by name, as a technique has them."""

from pssf.data.tissues import tissues
from pssf.xray.materials import Material, attenuation_per_mm, material_of


def material(name: str) -> Material:
    """The material that a name stands for."""
    return material_of(name, tissues())


def attenuation(name, energies_kev):
    """Of the material that a name stands for, 1/mm at each energy."""
    return attenuation_per_mm(material(name), energies_kev)
