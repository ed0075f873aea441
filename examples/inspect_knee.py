"""Write an HTML page that shows the solids of a knee, all or a selection, next to its radiograph."""

from pathlib import Path

import pssf
from pssf.io.meshes.knee_viewer import write_viewer


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write a sampled knee with KL grade 2 as one HTML page; the detector has `pixels` x `pixels` pixels."""
    knee = pssf.sample_knee(grade=2, rng=7)
    reference = pssf.load_protocol("reference")
    protocol = reference.resample(pixels)
    built = pssf.build(knee)
    radiograph = pssf.simulate(built, protocol, rng=7)
    return [write_viewer(built.scene, radiograph, out / "inspect_knee.html", title="Knee with KL grade 2")]


if __name__ == "__main__":
    run(Path("runs/examples"))
