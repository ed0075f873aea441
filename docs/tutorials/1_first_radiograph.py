r"""
1. First radiograph and its labels
==================================

In this lesson you simulate one radiograph, display it, and read its labels. The lesson takes a few seconds.
"""

# %%
# Sample a knee
# -------------
#
# A knee is described by a :class:`pssf.Knee`. ``sample_knee`` samples a knee from a grade table. The default table,
# ``population``, has the Kellgren-Lawrence (KL) grades 0 to 4, which overlap as in patients. The same seed ``rng``
# always gives the same knee.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import pssf

knee = pssf.sample_knee(grade=3, rng=7, side="right")
print("sex:", knee.sex, "| stature:", round(knee.stature_mm), "mm")
print("specified medial joint space:", round(knee.jsw_medial_mm, 2), "mm")
print("osteophytes:", [(one.site, round(one.size_mm, 1)) for one in knee.osteophytes])

# %%
# Choose a protocol
# -----------------
#
# A protocol contains technique, geometry and detector. ``fixed_flexion`` is the view of osteoarthritis trials. The
# detector of this protocol has 2048 x 2048 pixels. ``resample(512)`` keeps the field size and makes the pixels larger,
# so this page is built quickly. **For the full matrix, omit** ``.resample(512)``.

protocol = pssf.load_protocol("fixed_flexion").resample(512)
print(protocol.tube_kv, "kV,", protocol.mas, "mAs, pixels of", protocol.pixel_mm, "mm")

# %%
# Simulate
# --------
#
# ``rng`` is the seed of the quantum noise. ``keep=("masks",)`` adds masks: the silhouettes of bones and osteophytes.

radiograph = pssf.simulate(knee, protocol, rng=7, keep=("masks",))
print(radiograph)

# %%
# Linear pixels and display image
# -------------------------------
#
# ``radiograph.pixels`` are *for processing*: 16 bits, linear in the absorbed energy, with bright air. Use these pixels
# for measurements. ``render_for_display`` makes the image *for presentation*: with bright bone and the contrast of a
# clinical system.

shown = pssf.render_for_display(radiograph, processing="processed")
figure, axes = plt.subplots(1, 2, figsize=(9, 4.6), layout="constrained")
axes[0].imshow(radiograph.pixels, cmap="gray")
axes[0].set_title("for processing: linear, bright air")
axes[1].imshow(shown, cmap="gray")
axes[1].set_title("for presentation: bright bone")
for one in axes:
    one.set_axis_off()

# %%
# Read the labels
# ---------------
#
# ``radiograph.truth`` contains the labels of this radiograph. The labels come from the solids, not from the image. The
# specified joint space is defined in one posture. The radiograph of this lesson has another posture, so its minimum
# joint space differs from the specified joint space.

truth = radiograph.truth
print("KL grade:", truth.grade, "| grade of a simulated reader:", truth.reader_grade)
print("minimum medial joint space:", round(truth.jsw_medial_mm, 2), "mm")
print("minimum lateral joint space:", round(truth.jsw_lateral_mm, 2), "mm")
print("OARSI grades:", {name: value for name, value in truth.readings.items() if name.startswith("XR")})

# %%
# Landmarks are positions in pixels, as (row, column). Masks are boolean images.

figure, axis = plt.subplots(figsize=(5.4, 5), layout="constrained")
axis.imshow(shown, cmap="gray")
for name, colour in (("femur", "tab:cyan"), ("tibia", "tab:orange"), ("fibula", "tab:green"), ("patella", "tab:pink")):
    axis.contour(truth.masks[name], levels=[0.5], colors=colour, linewidths=1)
rows, cols = zip(*truth.landmarks_px.values(), strict=True)
axis.scatter(cols, rows, s=8, color="yellow")
axis.set_xlim(120, 400)
axis.set_ylim(400, 120)
axis.set_axis_off()

# %%
# Save
# ----
#
# A TIFF contains the linear pixels and all parameters. ``load`` reads pixels and parameters.

with tempfile.TemporaryDirectory() as folder:
    path = pssf.save(radiograph, Path(folder) / "knee.tif")
    print("the same radiograph:", pssf.load(path).truth.jsw_medial_mm == truth.jsw_medial_mm)

# %%
# The next lesson makes a set of labelled images for a network. All labels are defined in :doc:`/reference/labels`.
