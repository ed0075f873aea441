"""A hash of each person's radiographs, by which two folders can be held against each other."""

import hashlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd


def hashes(manifest: "pd.DataFrame", load_pixels: Callable[[str], NDArray[np.uint16]]) -> dict[str, str]:
    """Person -> hash of the pixels of all its radiographs and of their names, by name.

    Of pixels, not of files: a file also tells the versions of what it was made by.

    load_pixels  entry of the column `file` -> (rows, cols), DN
    """
    digests = {}
    for subject, part in manifest.groupby("subject"):
        digest = hashlib.sha256()
        for row in part.sort_values("radiograph").to_dict("records"):
            digest.update(f"{row['radiograph']}\n".encode())
            digest.update(np.ascontiguousarray(load_pixels(row["file"]), dtype="<u2").tobytes())
        digests[str(subject)] = digest.hexdigest()
    return digests


def agreement(made: Mapping[str, str], frozen: Mapping[str, str]) -> tuple[int, int]:
    """How many people have the hash that is written down, and of how many one is."""
    both = made.keys() & frozen.keys()
    return sum(made[name] == frozen[name] for name in both), len(both)


def as_toml(made: Mapping[str, str]) -> str:
    """As `data/benchmark_hashes.toml` has them."""
    head = "# Hashes of the pixels of people of benchmark-1, written by `pssf benchmark`; see benchmark/hashes.py.\n"
    lines = [f'"{name}" = "{made[name]}"' for name in sorted(made, key=int)]
    return "\n".join([head, "[sha256]", *lines, ""])
