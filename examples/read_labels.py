"""Write the labels of a small cohort, and read each file with common libraries, without this package."""

import csv
import json
from collections import Counter
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image

from pssf.cohort import make_cohort, plan_cohort, write_labels


def run(out: Path, pixels: int = 1024) -> list[Path]:
    """Make a cohort with KL grades 0, 2 and 4, and read its masks and labels. `pixels` is the detector size."""
    protocol = out / "mine.toml"
    size = f"rows = {pixels}\ncols = {pixels}\npixel_mm = {307.2 / pixels}\n"
    protocol.write_text(f'base = "fixed_flexion"\nname = "mine"\n{size}')
    overrides = {"knees": [1, 0, 1, 0, 1], "grades": "population", "protocols": [str(protocol)]}
    plan = plan_cohort("quick", seed=3, overrides=overrides, masks="tif")
    cohort, labels = out / "cohort", out / "labels"
    make_cohort(plan, cohort)
    write_labels(cohort, labels)
    print_readings(labels / "readings.csv")
    first = print_keypoints(labels / "coco.json")
    landmarks = labels / "landmarks" / f"{Path(first).stem}.pts"
    points = read_pts(landmarks)
    print(f"{landmarks.name}: {len(points)} landmarks, the first at x {points[0, 0]:.1f}, y {points[0, 1]:.1f} px")
    print_folders(labels / "images")
    masks = cohort / "masks" / f"{Path(first).stem}.tif"
    print_masks(masks)
    return [labels / "readings.csv", labels / "coco.json", landmarks, labels / "images" / first, masks]


def print_readings(path: Path) -> None:
    """Print the readings; `pandas.read_csv(path)` gives the same columns."""
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            side = {"1": "right", "2": "left"}[row["SIDE"]]
            osteophytes = "/".join(row[name] for name in ("XROSFM", "XROSTM", "XROSFL", "XROSTL"))
            print(
                f"subject {row['ID']}, {side}: KL {row['XRKL']}, reader {row['XRKL_READ']}; "
                f"medial JSW {float(row['MCMJSW']):.2f} mm, at 0.225 of the width {float(row['JSW225']):.2f} mm; "
                f"osteophytes {osteophytes}"
            )


def read_pts(path: Path) -> np.ndarray:
    """Read x and y, in pixels, of the landmarks in a .pts file."""
    lines = path.read_text().split("{")[1].split("}")[0].strip().splitlines()
    return np.array([[float(number) for number in line.split()] for line in lines])


def print_keypoints(path: Path) -> str:
    """Print keypoints in COCO format, which pycocotools can also read; return the name of the first image."""
    coco = json.loads(path.read_text())
    names = coco["categories"][0]["keypoints"]
    for image, annotation in zip(coco["images"], coco["annotations"], strict=True):
        x, y, _ = np.array(annotation["keypoints"]).reshape(-1, 3)[names.index("notch_top")]
        print(f"{image['file_name']}: {annotation['num_keypoints']} keypoints, top of the notch at ({x:.1f}, {y:.1f})")
    return str(coco["images"][0]["file_name"])


def print_folders(folder: Path) -> None:
    """Count the images per grade; `torchvision.datasets.ImageFolder(folder)` reads the same folders as classes."""
    counts = Counter(path.parent.name for path in folder.glob("*/*.png"))
    size = Image.open(next(folder.glob("*/*.png"))).size
    by_grade = ", ".join(f"{n} with KL grade {grade}" for grade, n in sorted(counts.items()))
    print(f"images: {by_grade}; {size[0]} x {size[1]}")


def print_masks(path: Path) -> None:
    """Print the area of each mask; the TIFF has one page per mask, with its name and the values 0 and 255."""
    with tifffile.TiffFile(path) as tiff:
        sizes = {page.tags["PageName"].value: np.count_nonzero(page.asarray()) for page in tiff.pages}
    print(f"{path.name}: {', '.join(f'{name} {size:,}' for name, size in sizes.items())} pixels")


if __name__ == "__main__":
    folder = Path("runs/examples/labels")
    folder.mkdir(parents=True, exist_ok=True)
    run(folder)
