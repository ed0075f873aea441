"""A page to inspect a knee: its solids, to turn and to take apart, beside its radiograph; opens in any browser."""

from pathlib import Path

import pssf
from pssf.io.meshes.knee_viewer import write_viewer


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write a drawn grade 2 knee as one HTML page; `pixels` is the side of the detector."""
    knee = pssf.sample_knee(grade=2, rng=7)
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    built = pssf.build(knee)
    radiograph = pssf.simulate(built, protocol, rng=7)
    return [write_viewer(built.scene, radiograph, out / "inspect_knee.html", title="Knee 7, inspected")]


if __name__ == "__main__":
    run(Path("runs/examples"))
