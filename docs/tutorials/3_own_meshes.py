r"""
3. Your own meshes and protocol, with an implant
================================================

In this lesson you build a scene from closed meshes, write your own protocol, and insert an implant into a
simulated knee. The images of this lesson have 256 x 256 pixels. **For the full size, set** ``MATRIX = 2048``.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import trimesh

import pssf

MATRIX = 256
work = Path(tempfile.mkdtemp())

# %%
# A scene of meshes
# -----------------
#
# A scene is a list of closed surfaces in millimetres. Each surface names the material inside and the material that
# surrounds it. In this example, trimesh makes the meshes; ``pssf.read_mesh("leg.stl")`` reads a file.

leg = trimesh.creation.cylinder(radius=50, height=240, sections=96)
shaft = trimesh.creation.cylinder(radius=14, height=230, sections=96)
canal = trimesh.creation.cylinder(radius=9, height=229, sections=96)
scene = pssf.Scene(
    [
        pssf.Surface(leg, inside="muscle", outside="air", name="leg"),
        pssf.Surface(shaft, inside="cortical_bone", outside="muscle", name="shaft"),
        pssf.Surface(canal, inside="marrow", outside="cortical_bone", name="canal"),
    ]
)

# %%
# A protocol of your own
# ----------------------
#
# A protocol is a TOML file. ``base`` refers to another protocol, and the file contains only the values that differ. All
# fields are listed in :doc:`/reference/protocol_fields`.

text = """
base = "reference"
name = "my_room"
tube_kv = 66.0
mas = 4.0
sdd_mm = 1100.0
sod_mm = 1000.0
grid_ratio = 8.0
"""
file = work / "my_room.toml"
file.write_text(text)
protocol = pssf.load_protocol(file).resample(MATRIX)
print(protocol.name, protocol.tube_kv, "kV, detector", protocol.sdd_mm - protocol.sod_mm, "mm behind the joint")

# %%
# Check before you simulate
# -------------------------
#
# ``check`` lists the faults of a scene: open meshes, wrong nesting, overlaps, and surfaces outside the field.

print(pssf.check(scene, protocol))

# %%
# Each fault is described in one line. In this example, the canal is longer than the shaft:

too_long = trimesh.creation.cylinder(radius=9, height=236, sections=96)
wrong = pssf.Scene([*scene.surfaces[:2], pssf.Surface(too_long, "marrow", "cortical_bone", "canal")])
print(pssf.check(wrong, protocol))

# %%
# Simulate the scene
# ------------------
#
# A scene has no labels. Path lengths are available: the length of each ray in each material, in millimetres.

radiograph = pssf.simulate(scene, protocol, rng=1, keep=("path_mm",))
bone_mm = radiograph.kept["path_mm"]["cortical_bone"]
figure, axes = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
axes[0].imshow(pssf.render_for_display(radiograph), cmap="gray")
axes[0].set_title("radiograph")
picture = axes[1].imshow(bone_mm, cmap="viridis")
axes[1].set_title("path length in cortical bone, mm")
figure.colorbar(picture, ax=axes[1], shrink=0.8)
for one in axes:
    one.set_axis_off()
print("longest path through bone:", round(float(bone_mm.max()), 2), "mm")

# %%
# An implant in a knee
# --------------------
#
# ``build`` makes the solids of a knee. ``insert`` adds a closed mesh, which displaces the tissues in its volume. A
# material is a name from the package, or a formula such as ``Ti=90,Al=6,V=4@4.43`` (percent by mass, density in
# g/cm3).

screw = trimesh.creation.cylinder(radius=2.5, height=60, sections=48)
screw.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
screw.apply_translation([0, 0, -25])

knee = pssf.Knee(side="right")
built = pssf.build(knee, protocol)
with_screw = built.insert(screw, "titanium_alloy", name="screw")
before = pssf.simulate(built, protocol, rng=1)
after = pssf.simulate(with_screw, protocol, rng=1, keep=("masks",))
print("implants:", [(step["name"], step["material"]) for step in after.surgery])
print("pixels that show the screw:", int(after.truth.masks["screw"].sum()))

figure, axes = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
for axis, one, title in zip(axes, (before, after), ("before", "after"), strict=True):
    axis.imshow(pssf.render_for_display(one, processing="processed"), cmap="gray")
    axis.set_title(title)
    axis.set_axis_off()

# %%
# Labels stay exact
# -----------------
#
# The screw does not touch the joint, so the joint space is unchanged. Labels that an operation makes meaningless are
# removed, and a :class:`pssf.SurgeryNotice` lists them.

print(before.truth.jsw_medial_mm == after.truth.jsw_medial_mm)

# %%
# The gallery shows a total knee replacement with resections: :doc:`/auto_gallery/index`.
