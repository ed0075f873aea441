"""Hashes of the radiographs of each subject, by which two copies of the data set can be compared."""

import hashlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd


def hash_subject_pixels(manifest: "pd.DataFrame", load_pixels: Callable[[str], NDArray[np.uint16]]) -> dict[str, str]:
    """Hash the pixels and the names of all radiographs of each subject.

    Pixels are hashed instead of files, since a file also holds the versions of the software that made it.

    Parameters
    ----------
    manifest : DataFrame
        Columns subject, radiograph and file, one row per radiograph.
    load_pixels : callable
        Entry of the column ``file`` -> (rows, cols) uint16 array, in DN.

    Returns
    -------
    dict of str to str
        Number of the subject -> SHA-256 hash. The radiographs of a subject are hashed in the order of their names.
    """
    digests = {}
    for subject, part in manifest.groupby("subject"):
        digest = hashlib.sha256()
        for row in part.sort_values("radiograph").to_dict("records"):
            digest.update(f"{row['radiograph']}\n".encode())
            digest.update(np.ascontiguousarray(load_pixels(row["file"]), dtype="<u2").tobytes())
        digests[str(subject)] = digest.hexdigest()
    return digests


def count_matching_hashes(computed: Mapping[str, str], published: Mapping[str, str]) -> tuple[int, int]:
    """Count the subjects whose hash equals the published one.

    Parameters
    ----------
    computed : mapping of str to str
        Subject -> hash, as `hash_subject_pixels` returns it.
    published : mapping of str to str
        Subject -> hash that the package publishes.

    Returns
    -------
    matching : int
        Number of subjects whose hashes are equal.
    compared : int
        Number of subjects that have both hashes.
    """
    both = computed.keys() & published.keys()
    return sum(computed[name] == published[name] for name in both), len(both)


def format_hashes_toml(computed: Mapping[str, str]) -> str:
    """Write hashes as TOML, in the format of ``data/benchmark_hashes.toml``.

    Parameters
    ----------
    computed : mapping of str to str
        Subject -> hash, as `hash_subject_pixels` returns it.

    Returns
    -------
    str
        TOML text.
    """
    head = "# SHA-256 of the pixels of each subject of benchmark-1, as `pssf benchmark` writes them to frozen.toml.\n"
    lines = [f'"{name}" = "{computed[name]}"' for name in sorted(computed, key=int)]
    return "\n".join([head, "[sha256]", *lines, ""])
