r"""
5. Radiographs to a table
=========================

In this lesson you read a folder of radiographs and write landmarks and joint space widths to a CSV file. The reader was
trained on simulated radiographs alone. It is for research, not for diagnosis. It needs the extra ``reader``:
``pip install "pssf[reader]"``.
"""

# %%
# Two radiographs
# ---------------
#
# Use a folder of your own frontal knee radiographs: PNG, JPEG, TIFF or DICOM, whole radiographs or crops, of one or
# both knees. This page simulates two radiographs instead.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from PIL import Image

import pssf

folder = Path(tempfile.mkdtemp())
for number, grade in enumerate((0, 2)):
    knee = pssf.sample_knee(grade=grade, rng=number, side=("right", "left")[number])
    radiograph = pssf.simulate(knee, pssf.load_protocol("fixed_flexion").resample(512), rng=number)
    Image.fromarray(pssf.render_for_display(radiograph).astype("uint8")).save(folder / f"knee_{number}.png")

# %%
# Five lines
# ----------
#
# :func:`pssf.read` returns the knees of a radiograph. ``pixel_mm`` is the pixel size on the detector. Without it,
# lengths are fractions of the width of the tibial plateau, unless the file contains the pixel size.

rows = []
for file in sorted(folder.glob("*.png")):
    rows += pssf.read(file, pixel_mm=0.6).rows()
table = pd.DataFrame(rows)
table.to_csv(folder / "knees.csv", index=False)

table[["status", "side", "plateau_width_mm", "medial_jsw_mm", "lateral_jsw_mm"]]

# %%
# Look at the readings
# --------------------
#
# Always look at the pictures before you use the numbers. In a notebook, a reading is shown as a picture. The status
# ``read`` means that nothing speaks against the reading; a refused knee has red landmarks and a reason.

figure, panels = plt.subplots(1, 2, figsize=(8, 4.4))
for panel, file in zip(panels, sorted(folder.glob("*.png")), strict=True):
    panel.imshow(pssf.read(file).draw())
    panel.set_axis_off()
figure.tight_layout()

# %%
# The same on the command line
# ----------------------------
#
# ``pssf landmarks FOLDER --pixel-mm 0.6 --out runs/read`` writes the table, one landmark file per knee (``.pts``) and
# one picture per radiograph. If you correct the landmark files of some radiographs, ``pssf train-reader --finetune``
# continues the training on them. :doc:`../validation/reader` reports the errors on radiographs of patients.
