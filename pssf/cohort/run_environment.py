"""Require that every worker of a run has the same folder, libraries and code as the machine that started the run."""

from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from platform import node

from ..core.checks import InputError
from ..data.code_hash import require_same_code
from ..io.cohort_records import require_claimed_folder
from ..simulation import collect_versions

# Subpackages and modules that affect the pixels and files of a run; its specification stores their hashes.
CODE_PATHS = (
    *("anatomy", "cohort", "core", "detector", "geometry", "io", "model", "raycast", "scatter"),
    *("image_faults.py", "simulation.py", "stages.py", "xray"),
)
# Module of each library that encodes image files. tifffile uses imagecodecs only where it is installed.
_FILE_LIBRARIES = {"imagecodecs": "imagecodecs", "pillow": "PIL", "tifffile": "tifffile"}


@dataclass(frozen=True, kw_only=True)
class RunEnvironment:
    """Describe the environment of a run, which must be identical on every worker.

    Attributes
    ----------
    folder : Path
        Absolute path of the output folder.
    claim : str
        Name of the file in the folder that specifies the run, such as "cohort.json".
    claim_sha256 : str
        SHA-256 hash of this file.
    versions : dict of str to str
        Versions of the package and of all libraries on which the pixels depend, keyed by name.
    code_hashes : dict of str to str
        Hashes of the code on which the pixels depend, keyed by path (`data.code_hash.compute_code_hashes`).
    """

    folder: Path
    claim: str
    claim_sha256: str
    versions: dict[str, str]
    code_hashes: dict[str, str]


def find_file_library_versions() -> dict[str, str]:
    """Find the versions of the libraries that affect the bytes of PNG and TIFF files.

    Returns
    -------
    dict of str to str
        Version of each library, keyed by name; "none" for a library that is not installed.
    """
    return {name: version(name) if find_spec(module) else "none" for name, module in _FILE_LIBRARIES.items()}


def require_same_environment(site: RunEnvironment) -> None:
    """Require that this machine has the folder, libraries and code of the machine that started the run.

    Parameters
    ----------
    site : RunEnvironment
        Environment on the machine that started the run.

    Raises
    ------
    InputError
        If the output folder, a library version or the code differs.
    """
    require_claimed_folder(site.folder / site.claim, site.claim_sha256)
    for name, here in {**collect_versions(), **find_file_library_versions()}.items():
        if here != site.versions.get(name, here):
            allowed = f"{site.versions[name]}, the version on the machine that started the run"
            raise InputError(f"{name} on {node()} must be {allowed}, got {here}")
    require_same_code(site.code_hashes)
