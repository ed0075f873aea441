"""Command that prints one digest of the pixels and labels of 40 radiographs.

Run ``python -m tools.pixel_hash`` in the folder `tests` before and after a change. If the digest is unchanged, tables
of `docs/validation` can be confirmed instead of measured again.
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
    """Simulate the radiographs and print the digest."""
    warnings.simplefilter("ignore")
    digest = hashlib.sha256()
    for grade in _GRADES:
        knee = pssf.sample_knee(grade=grade, rng=grade)
        for number, name in enumerate(_PROTOCOLS):
            protocol = pssf.load_protocol(name).resample(_MATRIX)
            engine = "scanline" if number % 2 else "embree"
            made = pssf.simulate(knee, protocol, rng=10 * grade + number, engine=engine, keep=("masks",))
            _add_radiograph(digest, made)
    print(digest.hexdigest()[:12])


def _add_radiograph(digest: "hashlib._Hash", made: pssf.Radiograph) -> None:
    """Add the pixels, landmarks, joint spaces and masks of a radiograph to a digest."""
    digest.update(made.pixels.tobytes())
    truth = made.truth
    assert truth is not None
    digest.update(repr((sorted(truth.landmarks_px.items()), truth.jsw_medial_mm, truth.jsw_lateral_mm)).encode())
    for name, mask in sorted((truth.masks or {}).items()):
        digest.update(name.encode() + np.packbits(mask).tobytes())


if __name__ == "__main__":
    main()
