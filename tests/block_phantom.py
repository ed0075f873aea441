"""A fast phantom of a knee: two blocks of bone in a limb, for tests of joint localisation and features."""

import numpy as np
from scipy.ndimage import gaussian_filter

from pssf.radiomics.localisation.templates import Template

PIXEL_MM = 0.5
SHAPE = (320, 320)


def make_phantom(row, col, side="right", scale=1.0, noise=0.0, seed=0, tibia_mm=2.5, bones=1.0):
    """Make a (320, 320) uint16 phantom of a limb in air with its medial joint gap at (row, col).

    The femur begins 2.5 mm above that row, the tibia `tibia_mm` below it.
    """
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    medial = (cols - col) * (1 if side == "right" else -1) * PIXEL_MM / scale  # mm, 0 in the medial gap
    up = (row - rows) * PIXEL_MM / scale
    limb = np.clip(1 - ((medial + 20) / 62) ** 2, 0, None)
    width = 17 - 0.12 * np.abs(up)
    bone = (np.abs(medial + 20) < 20 + width) & (np.abs(up) > np.where(up > 0, 2.5, tibia_mm) + 0.08 * np.abs(medial))
    notch = (np.abs(medial + 20) < 7) & (up > 0) & (up < 16)
    fibula = (np.abs(medial + 58) < 6) & (up < -12)
    path = 2.2 * limb + bones * (0.7 * gaussian_filter((bone & ~notch).astype(float), 0.8) + 0.4 * fibula)
    signal = 30000 * np.exp(-path)
    signal += noise * np.sqrt(signal) * np.random.default_rng(seed).standard_normal(SHAPE)
    return np.clip(np.rint(signal), 1, 65535).astype(np.uint16)


TEMPLATE = Template(pixels=make_phantom(160, 180), row=160, col=180, pixel_mm=PIXEL_MM, plateau_mm=74.0)
