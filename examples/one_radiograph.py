"""A drawn knee under the reference protocol: TIFF, PNG, and what is known about it."""

from pathlib import Path

import pssf


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write a grade 2 knee as TIFF and PNG; `pixels` is the side of the detector, which keeps its 307 mm."""
    knee = pssf.sample_knee(grade=2, rng=7)
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    radiograph = pssf.simulate(knee, protocol, rng=7)
    print(f"medial joint space {radiograph.truth.jsw_medial_mm} mm at pixel {radiograph.truth.medial_joint_line_px}")
    print(f"rays {radiograph.audit}")
    return [pssf.save(radiograph, out / f"one_radiograph.{suffix}") for suffix in ("tif", "png")]


if __name__ == "__main__":
    run(Path("runs/examples"))
