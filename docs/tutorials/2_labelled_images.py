r"""
2. 500 labelled images
======================

In this lesson you make a data set for a network with one command: images, label maps, landmarks and a table of labels,
divided by subject into training, validation and test sets. This page makes 5 images of 128 x 128 pixels. **For 500
images of 512 x 512 pixels, set** ``IMAGES = 500`` **and** ``MATRIX = 512``.
"""

# %%
# Estimate the cost
# -----------------
#
# With ``--dry-run``, the command ``pssf dataset`` simulates a few images and estimates CPU time, run time, disk space
# and number of files of the data set. It writes nothing.

import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

IMAGES = 5
MATRIX = 128

work = Path(tempfile.mkdtemp())


def run_pssf(*words: str) -> None:
    """Run a pssf command, as in a terminal, and print its output."""
    print("$ pssf", *(word.replace(str(work), "runs") for word in words))
    done = subprocess.run([sys.executable, "-m", "pssf", *words], check=True, capture_output=True, text=True)
    print(done.stdout.replace(str(work), "runs"))


run_pssf("dataset", "--images", str(IMAGES), "--matrix", str(MATRIX), "--dry-run", "--workers", "2")

# %%
# Make the data set
# -----------------
#
# By default, the knees have KL grades 0 to 4 with equal frequency, and are imaged in fixed flexion. Positioning, kV,
# mAs, collimated field and display processing vary between images, as in clinical practice. ``--split`` gives the
# fractions of subjects for training, validation and test.

run_pssf(
    "dataset", "--images", str(IMAGES), "--matrix", str(MATRIX), "--split", "0.6,0.2,0.2", "--seed", "3",
    "--out", f"{work}/train",
)  # fmt: skip
for path in sorted((work / "train").iterdir()):
    print(path.name)

# %%
# ``index.csv`` has one row per image. Names are hashes, so that no name predicts a label. Repeat the command to
# continue an interrupted run; ``pssf dataset verify`` checks all files.

with (work / "train" / "index.csv").open(newline="") as file:
    rows = list(csv.DictReader(file))
for row in rows[:5]:
    print(row["split"], row["name"], "KL", row["kl"], "medial", row["jsw_medial_mm"], "mm", row["side"])
run_pssf("dataset", "verify", f"{work}/train")

# %%
# Look at images and labels
# -------------------------
#
# Each image has four files: a 16-bit TIFF that is linear in the absorbed energy, a PNG that is processed for display, a
# label map, and a JSON file with all labels. ``dataset.json`` contains the values of the label map, such as 1 for the
# femur and 2 for the tibia.

folder = work / "train"
shown = rows[:5]
figure, axes = plt.subplots(2, len(shown), figsize=(10, 4.6), layout="constrained")
for row, (above, below) in zip(shown, axes.T, strict=True):
    image, label_map = (
        np.asarray(Image.open(folder / row["split"] / kind / f"{row['name']}.png")) for kind in ("display", "label_map")
    )
    labels = json.loads((folder / row["split"] / "labels" / f"{row['name']}.json").read_text())
    above.imshow(image, cmap="gray")
    places = np.array(list(labels["landmarks_px"].values()))
    above.scatter(places[:, 1], places[:, 0], s=4, color="yellow")
    above.set_title(f"KL {row['kl']}, {row['split']}", fontsize=9)
    below.imshow(label_map, cmap="tab10", vmin=0, vmax=9, interpolation="nearest")
    for axis in (above, below):
        axis.set_axis_off()

# %%
# The label map has one value per pixel, but bones overlap in projection. The JSON file of an image
# contains the complete masks as COCO instances. ``coco_train.json`` contains these instances and the landmarks as
# keypoints.

coco = json.loads((folder / "coco_train.json").read_text())
print(sorted({one.get("name", "knee") for one in coco["annotations"]}))

# %%
# Train a network
# ---------------
#
# With PyTorch, ``pssf.torch.KneeDataset`` reads the folder, and ``pssf.torch.KneeStream`` simulates new knees in every
# epoch (see :doc:`/how_to/make_dataset`):
#
# .. code-block:: python
#
#     from torch.utils.data import DataLoader
#     from pssf.torch import KneeDataset
#
#     training = KneeDataset("runs/train", "train")
#     for batch in DataLoader(training, batch_size=16, shuffle=True):
#         batch["image"], batch["label_map"], batch["landmarks_px"], batch["kl"]
#
# The examples ``train_pytorch``, ``train_monai`` and ``train_torchio`` of the gallery each train a network for three
# epochs. A network that is trained on these images is not validated for use on patients. See
# :doc:`/explanation/limits`.
