"""Helpers that find materials by name and build a limb of tissues."""

from pssf.data.anatomy.tissue_table import load_tissues
from pssf.geometry.scene import Scene
from pssf.validation.imaging import scatter_phantoms
from pssf.xray.materials import Material, attenuation_per_mm, resolve_material


def find_material(name: str) -> Material:
    """Return the material of a tissue name or chemical formula."""
    return resolve_material(name, load_tissues())


def build_limb(thick_mm: float) -> Scene:
    """Build an elliptical limb phantom with the tissues of the package."""
    return scatter_phantoms.build_limb(thick_mm, load_tissues())


def compute_attenuation(name, energies_kev):
    """Compute the linear attenuation of a named material at each energy, in 1/mm."""
    return attenuation_per_mm(find_material(name), energies_kev)
