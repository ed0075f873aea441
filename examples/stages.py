"""The stages of one exposure: primary, scatter, what the detector would read without noise, and what it reads."""

import dataclasses
from pathlib import Path

import numpy as np

import pssf
from pssf.io.pictures import apply_heat_map, make_panel, write_image_row


def run(out: Path, pixels: int = 2048) -> list[Path]:
    """Write the stages of a knee at a low dose as one PNG; `pixels` is the side of the detector."""
    low = pssf.load_protocol("low_dose")
    protocol = dataclasses.replace(low, rows=pixels, cols=pixels, pixel_mm=307.2 / pixels)
    radiograph = pssf.simulate(pssf.Knee(), protocol, rng=1, keep=("primary", "scatter", "noise_free"))
    primary, scatter = radiograph.kept["primary"], radiograph.kept["scatter"]
    joint = np.s_[pixels * 5 // 16 : pixels * 11 // 16, pixels * 5 // 16 : pixels * 11 // 16]
    ratio = scatter[joint] / primary[joint]
    print(f"scatter over primary about the joint: {ratio.min():.2f} to {ratio.max():.2f}")
    noise = radiograph.pixels.astype(np.float64) - radiograph.kept["noise_free"]
    shown = {
        "primary": apply_heat_map(np.log(primary[joint] / primary[joint].min()), 3.0),
        "scatter / primary, 0 to 4": apply_heat_map(ratio, 4.0),
        "without noise": pssf.render_for_display(radiograph.kept["noise_free"], processing="processed")[joint],
        "as read": pssf.render_for_display(radiograph.pixels, processing="processed")[joint],
        "noise": np.clip(128 + noise[joint] / 2, 0, 255).astype(np.uint8),
    }
    return [write_image_row([make_panel(image, 320, 320, name) for name, image in shown.items()], out / "stages.png")]


if __name__ == "__main__":
    run(Path(__file__).parent)
