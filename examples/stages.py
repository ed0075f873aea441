"""Show the stages of one exposure: primary, scatter, their ratio, the image without and with noise, and the noise."""

from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row

SIDE = 400


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the stages of an exposure at low dose as one PNG; the detector has `pixels` x `pixels` pixels."""
    protocol = pssf.load_protocol("low_dose").resample(pixels)
    radiograph = pssf.simulate(pssf.Knee(), protocol, rng=1, keep=("primary", "scatter", "noise_free"))
    primary, scatter = radiograph.kept["primary"], radiograph.kept["scatter"]
    window = np.s_[pixels * 5 // 16 : pixels * 11 // 16, pixels * 5 // 16 : pixels * 11 // 16]
    ratio = scatter[window] / primary[window]
    print(f"scatter over primary around the joint: {ratio.min():.2f} to {ratio.max():.2f}")
    noise = radiograph.pixels.astype(np.float64) - radiograph.kept["noise_free"]
    images = {
        "primary": apply_heat_map(np.log(primary[window] / primary[window].min()), 3.0),
        "scatter": apply_heat_map(scatter[window], float(scatter[window].max())),
        "scatter / primary, 0 to 4": apply_heat_map(ratio, 4.0),
        "without noise": pssf.render_for_display(radiograph.kept["noise_free"], processing="processed")[window],
        "with noise": pssf.render_for_display(radiograph.pixels, processing="processed")[window],
        "noise": np.clip(128 + noise[window] / 2, 0, 255).astype(np.uint8),
    }
    panels = [make_panel(image, SIDE, SIDE, name) for name, image in images.items()]
    columns = [np.vstack(panels[first::3]) for first in range(3)]
    return [write_image_row(columns, out / "stages.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
