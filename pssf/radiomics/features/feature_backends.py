"""Feature backends: the libraries pyradiomics and MIRP, which measure radiomic features."""

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec

from ...core.checks import InputError, require_choice


@dataclass(frozen=True, kw_only=True)
class Backend:
    """Library that measures radiomic features.

    Attributes
    ----------
    module : str
        Name of the Python module of the library.
    libraries : tuple of str
        PyPI package names of the libraries whose versions affect feature values.
    missing_features : tuple of str
        Features that the other backend measures, but this backend does not.
    """

    module: str
    libraries: tuple[str, ...]
    missing_features: tuple[str, ...] = ()


# Backends by name; the first installed backend is the default.
BACKENDS = {
    "pyradiomics": Backend(module="radiomics", libraries=("pyradiomics", "simpleitk")),
    "mirp": Backend(module="mirp", libraries=("mirp",), missing_features=("glcm_MCC",)),
}


def is_installed(name: str) -> bool:
    """Return whether a backend is installed.

    Parameters
    ----------
    name : str
        Name of the backend, one of BACKENDS.

    Returns
    -------
    bool
        True if the module of the backend is installed.
    """
    return find_spec(BACKENDS[name].module) is not None


def default_backend() -> str:
    """Return the name of the first installed backend in BACKENDS.

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
            f"no radiomics backend ({' or '.join(BACKENDS)}) is installed: install MIRP with pip install 'pssf[study]'"
        )
    return installed[0]


def require_backend(name: str) -> None:
    """Check that a backend is known and installed.

    Parameters
    ----------
    name : str
        Name of the backend.

    Raises
    ------
    InputError
        The backend is unknown or not installed.
    """
    require_choice("backend", name, tuple(BACKENDS))
    if not is_installed(name):
        there = ", ".join(other for other in BACKENDS if is_installed(other)) or "none"
        raise InputError(f"backend must be an installed backend ({there}), got {name!r}")


def select_backend(name: str, features: Iterable[str], consumer: str) -> str:
    """Select the specified backend if it is installed, else an installed backend that has all required features.

    Parameters
    ----------
    name : str
        Preferred backend, one of BACKENDS.
    features : iterable of str
        Names of the required features, such as glcm_Contrast.
    consumer : str
        Name of the model or object that requires the features, shown in the error message.

    Returns
    -------
    str
        Name of the backend.

    Raises
    ------
    InputError
        No installed backend has all required features.
    """
    require_choice("backend", name, tuple(BACKENDS))
    if is_installed(name):
        return name
    other = default_backend()
    lacking = [feature for feature in features if feature in BACKENDS[other].missing_features]
    if lacking:
        raise InputError(
            f"{consumer} needs {', '.join(lacking)}, which backend {other} does not measure: install {name}"
        )
    return other
