"""Materials by name, as a technique has them."""

from pssf.accuracy import scatter
from pssf.data.tissues import tissues
from pssf.geometry.scene import Scene
from pssf.xray.materials import Material, attenuation_per_mm, material_of


def material(name: str) -> Material:
    """The material that a name stands for."""
    return material_of(name, tissues())


def limb(thick_mm: float) -> Scene:
    """An elliptic limb of tissues by name."""
    return scatter.limb(thick_mm, tissues())


def attenuation(name, energies_kev):
    """Of the material that a name stands for, 1/mm at each energy."""
    return attenuation_per_mm(material(name), energies_kev)
