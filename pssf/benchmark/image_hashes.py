"""Hashes of the radiographs of each subject, to compare two copies of the data set."""

import hashlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd


def hash_subject_pixels(manifest: "pd.DataFrame", load_pixels: Callable[[str], NDArray[np.uint16]]) -> dict[str, str]:
    """Hash the pixels and the names of all radiographs of each subject.

    The files themselves are not hashed, because they also contain the versions of the software that wrote them.

    Parameters
    ----------
    manifest : DataFrame
        Columns subject, radiograph and file, one row per radiograph.
    load_pixels : callable
        Function that maps an entry of the column ``file`` to a (rows, cols) uint16 array, in DN.

    Returns
    -------
    dict of str to str
        SHA-256 hash of each subject, keyed by subject number. Radiographs are hashed in alphabetical order.
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
    """Count the subjects whose hash equals the published hash.

    Parameters
    ----------
    computed : mapping of str to str
        Hash of each subject, from `hash_subject_pixels`.
    published : mapping of str to str
        Published hash of each subject, as stored in the package.

    Returns
    -------
    matching : int
        Number of subjects with equal hashes.
    compared : int
        Number of subjects that have both a computed and a published hash.
    """
    both = computed.keys() & published.keys()
    return sum(computed[name] == published[name] for name in both), len(both)


def format_hashes_toml(computed: Mapping[str, str]) -> str:
    """Format hashes as TOML, as in ``data/benchmark_hashes.toml``.

    Parameters
    ----------
    computed : mapping of str to str
        Hash of each subject, from `hash_subject_pixels`.

    Returns
    -------
    str
        TOML text.
    """
    head = "# SHA-256 hash of the pixels of each subject of benchmark-1, written to frozen.toml by `pssf benchmark`.\n"
    lines = [f'"{name}" = "{computed[name]}"' for name in sorted(computed, key=int)]
    return "\n".join([head, "[sha256]", *lines, ""])
