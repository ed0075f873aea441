r"""
2. Labelled images for a network
================================

In this lesson you make a data set for a network: images sorted by grade, landmarks, masks and a table of labels. This
page makes 5 images of 128 x 128 pixels. **For 500 images, set** ``KNEES_PER_GRADE = 100`` **and** ``MATRIX = 512``.
"""

# %%
# Make a cohort
# -------------
#
# The command ``pssf cohort`` makes a cohort. ``--knees`` gives the number of knees of each KL grade, from 0 to 4.
# ``--acquisition sampled`` varies positioning, beam, dose and field, as in a clinic. ``--masks`` writes the masks of
# every radiograph.

import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import pssf

KNEES_PER_GRADE = 1
MATRIX = 128

work = Path(tempfile.mkdtemp())


def run_pssf(*words: str) -> None:
    """Run a pssf command, as in a terminal."""
    print("$ pssf", *(word.replace(str(work), "runs") for word in words))
    subprocess.run([sys.executable, "-m", "pssf", *words], check=True, capture_output=True)


run_pssf(
    "cohort", "--preset", "population", "--knees", ",".join([str(KNEES_PER_GRADE)] * 5),
    "--matrix", str(MATRIX), "--acquisition", "sampled", "--masks", "--seed", "3", "--out", f"{work}/cohort",
)  # fmt: skip

# %%
# The folder contains the images, the masks, one record per knee, and ``manifest.csv`` with one row per radiograph.
# Repeat the command to continue an interrupted run.

for path in sorted(work.glob("cohort/*")):
    print(path.name)
with (work / "cohort" / "manifest.csv").open() as file:
    rows = list(csv.DictReader(file))
for row in rows:
    print(row["file"], "KL", row["grade"], "medial", row["jsw_medial_mm"], "mm", row["side"])

# %%
# Subjects are numbered at random, so no file name predicts a grade. If a knee cannot be built, the cohort stops with an
# error that names the conflicting fields; use another seed.
#
# Export the labels
# -----------------
#
# ``pssf cohort labels`` writes the labels in common formats: readings with the columns of the Osteoarthritis
# Initiative, landmarks as ``.pts`` files and as COCO keypoints, and 8-bit images in one folder per grade.
# ``ImageFolder`` of torchvision reads these folders.

run_pssf("cohort", "labels", f"{work}/cohort", "--out", f"{work}/labels")
for path in sorted(work.glob("labels/images/*/*.png")):
    print(path.relative_to(work))
keypoints = json.loads((work / "labels" / "coco.json").read_text())
print(keypoints["categories"][0]["keypoints"])

# %%
# Load a batch
# ------------
#
# Any image library can read the exported files. The following code loads a batch with numpy and Pillow. The grade is
# the name of the folder. With torchvision, use ``ImageFolder("runs/labels/images")``.

files = sorted(work.glob("labels/images/*/*.png"))
images = np.stack([np.asarray(Image.open(path), dtype=np.float32) / 255 for path in files])
grades = np.array([int(path.parent.name) for path in files])
print(images.shape, grades)

points = {
    entry["file_name"]: one["keypoints"]
    for entry, one in zip(keypoints["images"], keypoints["annotations"], strict=True)
}
figure, axes = plt.subplots(1, len(files), figsize=(10, 2.6), layout="constrained")
for axis, path, image in zip(axes, files, images, strict=True):
    flat = points[path.relative_to(work / "labels" / "images").as_posix()]
    axis.imshow(image, cmap="gray")
    axis.scatter(flat[0::3], flat[1::3], s=4, color="yellow")
    axis.set_title(f"KL {path.parent.name}")
    axis.set_axis_off()

# %%
# Masks as a label map
# --------------------
#
# Every mask of a radiograph is a separate image, because bones overlap in projection. A label map needs an order: in
# this example, later masks overwrite earlier masks.

row = rows[0]
masks = pssf.load_masks(work / "cohort" / row["masks"])
label_map = np.zeros(next(iter(masks.values())).shape, np.uint8)
for value, name in enumerate(("fibula", "tibia", "femur", "patella"), start=1):
    label_map[masks[name]] = value
print({int(value): int((label_map == value).sum()) for value in np.unique(label_map)})

# %%
# Split by subject
# ----------------
#
# All radiographs of a subject must be in the same set. The manifest has the column ``subject``.

subjects = sorted({row["subject"] for row in rows})
parts = np.random.default_rng(0).permuted(np.arange(len(subjects)) % 5 == 0)
test = {subject for subject, chosen in zip(subjects, parts, strict=True) if chosen}
print("test subjects:", sorted(test))

# %%
# A network that is trained on these images is not validated for use on patients. See :doc:`/explanation/limits`.
