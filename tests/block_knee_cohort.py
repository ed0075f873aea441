"""A fast synthetic cohort for the study: radiographs of knees made of two blocks, and patient films of them."""

import hashlib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from PIL import Image
from scipy.ndimage import gaussian_filter, zoom
from synthetic_features import PROTOCOLS

from pssf.detector import render_for_display
from pssf.io.patients.patient_radiographs import FilmImage, list_films, read_film
from pssf.radiomics.localisation.templates import Template
from pssf.study import FilmSet, StudySettings

SIZE, PIXEL_MM = 256, 0.6


def render_block_knee(
    grade: int, row: float, col: float, side: str, coarse: float, gain: float, seed: int
) -> np.ndarray:
    """Render a limb with two blocks of bone; a higher grade has a narrower gap and a coarser texture."""
    rng = np.random.default_rng(seed)
    rows, cols = np.mgrid[:SIZE, :SIZE].astype(float)
    medial = (cols - col) * (1 if side == "right" else -1) * PIXEL_MM
    up = (row - rows) * PIXEL_MM
    limb = np.clip(1 - ((medial + 20) / 62) ** 2, 0, None)
    bone = (np.abs(medial + 20) < 37 - 0.12 * np.abs(up)) & (np.abs(up) > 3.0 - 0.5 * grade + 0.08 * np.abs(medial))
    notch = (np.abs(medial + 20) < 7) & (up > 0) & (up < 16)
    field = gaussian_filter(rng.standard_normal((SIZE, SIZE)), coarse + 0.6 * grade)
    inside = gaussian_filter((bone & ~notch).astype(float), 0.8)
    signal = gain * np.exp(-2.2 * limb - inside * (0.7 + 0.05 * field / field.std()))
    signal += np.sqrt(signal) * rng.standard_normal(signal.shape)
    return np.clip(np.rint(signal), 1, 65535).astype(np.uint16)


class Cohort:
    """A manifest of `per_grade` subjects per grade under three protocols; pixels are rendered on request."""

    def __init__(self, per_grade: int, grades: int = 3) -> None:
        rng = np.random.default_rng(11)
        self.rows = []
        for subject in range(grades * per_grade):
            identity = {
                "side": ["right", "left"][subject % 2],
                "subject": subject,
                "knee": subject,
                "grade": subject % grades,
            }
            row, col = rng.uniform(115, 140), rng.uniform(115, 140)
            for protocol in PROTOCOLS:
                name = f"s{subject:03d}_{protocol}"
                truth = {"truth_medial_row_px": row, "truth_medial_col_px": col, "pixel_mm": PIXEL_MM}
                file = {"radiograph": name, "file": name, "sha256": hashlib.sha256(name.encode()).hexdigest()}
                self.rows.append(identity | truth | file | {"protocol": protocol, "sdd_mm": 1150.0, "sod_mm": 950.0})
        self.manifest = pd.DataFrame(self.rows)

    def retest(self, knees: int) -> pd.DataFrame:
        """List the first knees imaged twice more with new noise, and twice with new noise and a shift to the left."""
        rows = []
        for row in [row for row in self.rows if row["protocol"] == "reference"][:knees]:
            for index, (kind, turn) in enumerate((k, t) for k in ("noise", "perturbation") for t in ("1", "2")):
                name = f"{row['radiograph']}_{kind}{turn}"
                file = {"radiograph": name, "file": name, "sha256": hashlib.sha256(name.encode()).hexdigest()}
                moved = {"truth_medial_col_px": row["truth_medial_col_px"] - 0.4 * (kind == "perturbation")}
                rows.append(
                    row | file | moved | {"kind": kind, "repeat_index": turn, "draw": 10_000 + 10 * row["knee"] + index}
                )
        self.rows += [row for row in rows if row["radiograph"] not in {known["radiograph"] for known in self.rows}]
        return pd.DataFrame(rows)

    def load(self, file: str) -> np.ndarray:
        row = next(row for row in self.rows if row["file"] == file)
        gain = {"reference": 30000, "low_dose": 6000, "geometry_shift": 25000}[row["protocol"]]
        at = row["truth_medial_row_px"], row["truth_medial_col_px"]
        seed = row.get("draw", 100 * row["subject"] + PROTOCOLS.index(row["protocol"]))
        return render_block_knee(row["grade"], *at, row["side"], 1.0, gain, seed)

    def display(self, file: str) -> FilmImage:
        """Return one radiograph of the cohort after display processing."""
        row = next(row for row in self.rows if row["file"] == file)
        return FilmImage(
            pixels=render_for_display(self.load(file), bits=16) / 65535.0, pixel_mm=PIXEL_MM, side=row["side"]
        )


def write_film(
    path: Path, grade: int, side: str, seed: int, *, polarity: str = "bone bright", zoomed: float = 0.8
) -> Path:
    """Write the radiograph of a block knee as an 8-bit PNG, resampled by the factor `zoomed`."""
    rng = np.random.default_rng(seed)
    pixels = render_block_knee(grade, *rng.uniform(120, 136, 2), side, 1.0, 30000, 1000 + seed)
    displayed = np.clip(zoom(render_for_display(pixels).astype(float), zoomed, order=1), 0, 255).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(255 - displayed if polarity == "bone dark" else displayed).save(path)
    return path


TEMPLATE = Template(
    pixels=render_block_knee(0, 128, 140, "right", 3.0, 60000, 0), row=128, col=140, pixel_mm=PIXEL_MM, plateau_mm=74.0
)
SMALL = StudySettings(region_px=80, bins=32, repeats=2, replicates=200, selections=("l1",), models=("lr",))
# Settings of the smallest study with patient films: one protocol, two grades and two feature families.
LIGHT = replace(SMALL, repeats=1, replicates=100, families=("shape2D", "glcm"))


@cache
def make_cohort() -> Cohort:
    return Cohort(5)


def select_text_subjects() -> pd.DataFrame:
    """Select radiographs with grades 0 and 2 under the reference protocol; subject identifiers are strings."""
    manifest = make_cohort().manifest
    part = manifest[(manifest["protocol"] == "reference") & (manifest["grade"] != 1)]
    return part.assign(subject=[f"P-{subject:02d}" for subject in part["subject"]])


def write_films(folder: Path) -> Path:
    """Write a folder of films by grade, with three films from which no region can be extracted."""
    for index, grade in enumerate((0, 0, 2, 2, 3, 3, 1)):
        name = f"p{index:03d}{'RL'[index % 2]}.png"
        polarity = "bone dark" if index % 3 == 1 else "bone bright"
        write_film(folder / str(grade) / name, min(grade, 2), ("right", "left")[index % 2], index, polarity=polarity)
    whole = Image.open(folder / "0" / "p000R.png")
    # The joint line is about 100 pixels below the upper edge; a region extends 30 pixels to either side.
    whole.crop((0, 80, whole.width, whole.height)).save(folder / "0" / "n000R.png")
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(90, 110, (200, 200)).astype(np.uint8)).save(folder / "0" / "air1R.png")
    (folder / "2" / "torn2R.png").write_bytes(b"torn")
    return folder


def make_film_set(folder: Path, **changes: Any) -> FilmSet:
    """Make a film set from a folder of films; simulated radiographs come from the cohort after display processing."""
    settings = {
        "protocol": "reference",
        "load": lambda file: read_film(folder / file),
        "load_cohort": make_cohort().display,
    }
    return FilmSet(films=list_films(folder), **settings | changes)
