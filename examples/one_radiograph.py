"""Simulate a sampled knee under the protocol `reference`, save it as TIFF and PNG, and print some of its labels."""

from pathlib import Path

import pssf


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write a knee with KL grade 2 as TIFF and PNG. The detector has `pixels` x `pixels` pixels on 307 mm."""
    knee = pssf.sample_knee(grade=2, rng=7)
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    radiograph = pssf.simulate(knee, protocol, rng=7)
    row, col = radiograph.truth.medial_joint_line_px
    print(f"medial joint space {radiograph.truth.jsw_medial_mm:.2f} mm, at row {row:.0f} and column {col:.0f}")
    print(f"audit of the rays: {radiograph.audit}")
    return [pssf.save(radiograph, out / f"one_radiograph.{suffix}") for suffix in ("tif", "png")]


if __name__ == "__main__":
    run(Path("runs/examples"))
