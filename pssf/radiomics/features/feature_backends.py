"""Feature backends: the library that measures features, pyradiomics if it is installed, else MIRP."""

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec

from ...core.checks import InputError, require_choice


@dataclass(frozen=True, kw_only=True)
class Backend:
    """A library that measures features.

    Attributes
    ----------
    module : str
        Module that is imported.
    libraries : tuple of str
        Libraries whose versions affect the values, by their names in the package index.
    missing_features : tuple of str
        Features that the other backend has and this one lacks.
    """

    module: str
    libraries: tuple[str, ...]
    missing_features: tuple[str, ...] = ()


# The first one that is installed is the default.
BACKENDS = {
    "pyradiomics": Backend(module="radiomics", libraries=("pyradiomics", "simpleitk")),
    "mirp": Backend(module="mirp", libraries=("mirp",), missing_features=("glcm_MCC",)),
}


def is_installed(name: str) -> bool:
    """Return whether a backend is installed.

    Parameters
    ----------
    name : str
        One of BACKENDS.

    Returns
    -------
    bool
        True if it can be imported.
    """
    return find_spec(BACKENDS[name].module) is not None


def default_backend() -> str:
    """Return the first of BACKENDS that is installed.

    Returns
    -------
    str
        Name of the backend.

    Raises
    ------
    InputError
        No backend is installed.
    """
    installed = [name for name in BACKENDS if is_installed(name)]
    if not installed:
        raise InputError(
            f"a radiomics backend must be installed, {' or '.join(BACKENDS)}, got none: install MIRP with "
            "pip install 'pssf[study]'"
        )
    return installed[0]


def require_backend(name: str) -> None:
    """Require that a backend is known and installed.

    Parameters
    ----------
    name : str
        Name of the backend.

    Raises
    ------
    InputError
        The backend is unknown, or is not installed.
    """
    require_choice("backend", name, tuple(BACKENDS))
    if not is_installed(name):
        there = ", ".join(other for other in BACKENDS if is_installed(other)) or "none"
        raise InputError(f"backend must be one that is installed ({there}), got {name!r}")


def select_backend(name: str, features: Iterable[str], consumer: str) -> str:
    """Select an installed backend that measures some features: the named one, else another that has all of them.

    Parameters
    ----------
    name : str
        Backend that first measured the features, one of BACKENDS.
    features : iterable of str
        Names of the features, such as glcm_Contrast.
    consumer : str
        Object that uses the features, to name in the message.

    Returns
    -------
    str
        Name of the backend.

    Raises
    ------
    InputError
        No installed backend has all the features.
    """
    require_choice("backend", name, tuple(BACKENDS))
    if is_installed(name):
        return name
    other = default_backend()
    lacking = [feature for feature in features if feature in BACKENDS[other].missing_features]
    if lacking:
        raise InputError(f"{consumer} must have {', '.join(lacking)}, got {other}, which lacks them: install {name}")
    return other
