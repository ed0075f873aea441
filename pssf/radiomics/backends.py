"""Which program measures the features: pyradiomics where it is installed, else MIRP."""

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec

from ..core.checks import InputError, require_choice


@dataclass(frozen=True, kw_only=True)
class Backend:
    """A program that measures features.

    module     that is imported
    libraries  whose versions a value depends on, as they are called in a package index
    lacks      features that the other has
    """

    module: str
    libraries: tuple[str, ...]
    lacks: tuple[str, ...] = ()


# The first that is installed is taken.
BACKENDS = {
    "pyradiomics": Backend(module="radiomics", libraries=("pyradiomics", "simpleitk")),
    "mirp": Backend(module="mirp", libraries=("mirp",), lacks=("glcm_MCC",)),
}


def is_installed(name: str) -> bool:
    """Whether a backend, one of BACKENDS, can be imported here."""
    return find_spec(BACKENDS[name].module) is not None


def default_backend() -> str:
    """The first of BACKENDS that is installed.

    raises  InputError where there is none
    """
    installed = [name for name in BACKENDS if is_installed(name)]
    if not installed:
        raise InputError(
            f"backend of features = none; allowed: {' or '.join(BACKENDS)}, installed; mirp comes, in the source "
            "folder, with: pip install '.[study]'"
        )
    return installed[0]


def require_backend(name: str) -> None:
    """Refuse a backend that is unknown or not installed.

    raises  InputError
    """
    require_choice("backend", name, tuple(BACKENDS))
    if not is_installed(name):
        there = ", ".join(other for other in BACKENDS if is_installed(other)) or "none is"
        raise InputError(f"backend = {name!r}, not installed here; allowed: what is: {there}")


def backend_for(name: str, features: Iterable[str], what: str) -> str:
    """The backend that measures some features here: the one named if it is installed, else another that has them all.

    name      of BACKENDS, which measured them first
    features  names, such as glcm_Contrast
    what      that reads the features, as it is called in a refusal
    raises    InputError where none here has them all
    """
    require_choice("backend", name, tuple(BACKENDS))
    if is_installed(name):
        return name
    other = default_backend()
    lacking = [feature for feature in features if feature in BACKENDS[other].lacks]
    if lacking:
        raise InputError(f"{what}: reads {', '.join(lacking)}, which {other} lacks; allowed: with {name} installed")
    return other
