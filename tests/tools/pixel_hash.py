"""Command that prints two digests of 40 radiographs: of pixels and labels, and of path lengths and labels.

Run ``python -m tools.pixel_hash`` in the folder `tests` before and after a change. If the first digest is unchanged,
tables of `docs/validation` can be confirmed instead of measured again. If only the second one is, those tables can be
confirmed that depend on the geometry alone.
"""

import hashlib
import warnings

import numpy as np

import pssf

# Protocols that differ in view, posture, detector, grid and field, and the number of pixels along the longer side.
_PROTOCOLS = (
    "reference",
    "fixed_flexion",
    "skyline",
    "lateral",
    "gos_screen",
    "scatter_grid",
    "high_kv",
    "lyon_schuss",
)
_MATRIX = 384
_GRADES = range(5)


def main() -> None:
    """Simulate the radiographs and print the digests."""
    warnings.simplefilter("ignore")
    pixels, paths = hashlib.sha256(), hashlib.sha256()
    for grade in _GRADES:
        knee = pssf.sample_knee(grade=grade, rng=grade)
        for number, name in enumerate(_PROTOCOLS):
            protocol = pssf.load_protocol(name).resample(_MATRIX)
            engine = "scanline" if number % 2 else "embree"
            made = pssf.simulate(knee, protocol, rng=10 * grade + number, engine=engine, keep=("masks", "path_mm"))
            pixels.update(made.pixels.tobytes())
            for material, lengths in sorted(made.kept["path_mm"].items()):
                paths.update(material.encode() + np.asarray(lengths, np.float32).tobytes())
            for digest in (pixels, paths):
                _add_labels(digest, made)
    print(f"pixels and labels {pixels.hexdigest()[:12]}, path lengths and labels {paths.hexdigest()[:12]}")


def _add_labels(digest: "hashlib._Hash", made: pssf.Radiograph) -> None:
    """Add the landmarks, joint spaces and masks of a radiograph to a digest."""
    truth = made.truth
    assert truth is not None
    digest.update(repr((sorted(truth.landmarks_px.items()), truth.jsw_medial_mm, truth.jsw_lateral_mm)).encode())
    for name, mask in sorted((truth.masks or {}).items()):
        digest.update(name.encode() + np.packbits(mask).tobytes())


if __name__ == "__main__":
    main()
