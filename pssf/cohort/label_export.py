"""Export the labels of a cohort: OAI columns, landmark files, COCO keypoints, and images sorted by grade."""

from pathlib import Path
from typing import Any

import numpy as np

from ..core.checks import InputError
from ..core.label_names import CONTOUR_LANDMARKS
from ..detector.display_rendering import render_for_display
from ..io.atomic_write import make_folder
from ..io.cohort_records import read_csv, write_csv
from ..io.label_formats import LabelledImage, write_coco, write_pts
from ..io.pictures import write_image_row
from ..io.radiograph_files import load, load_parameters
from ..model.knee import Knee
from ..model.limb_axes import STRAIGHT_LEG_DEG
from ..model.radiograph import Truth

# Codes of the Osteoarthritis Initiative (OAI) in the column SIDE, keyed by knee side.
_SIDE_CODES = {"right": 1, "left": 2}
# Readings that are exported only under their name and sign convention in the Osteoarthritis Initiative.
_OAI_RENAMED_READINGS = ("hip_knee_ankle_deg",)


def write_labels(cohort: str | Path, out: str | Path) -> list[Path]:
    """Write the labels of all radiographs of a cohort, and the radiographs as 8-bit images sorted by KL grade.

    Parameters
    ----------
    cohort : str or Path
        Folder of a cohort that `make_cohort` has made.
    out : str or Path
        Output folder; must differ from `cohort`.

    Returns
    -------
    list of Path
        Paths of readings.csv and coco.json, and of the folders landmarks and images.

    Raises
    ------
    InputError
        If `cohort` contains no complete cohort, or a radiograph is not frontal. If `out` is the same folder as
        `cohort`, or the disk is full or not writable.

    Notes
    -----
    ``readings.csv`` has one row per radiograph. The following columns have the names of the Osteoarthritis
    Initiative (OAI), without the visit prefix, such as V00:

    - ID; SIDE (1 right, 2 left); XRKL and the OARSI grades (`model.oarsi_grades`).
    - HKANGLE, hip-knee-ankle angle in degrees; varus is negative.
    - MCMJSW, minimum medial joint space width; JSW150 to JSW300 (medial) and LJSW700 to LJSW900 (lateral), joint space
      widths at fixed locations; all in mm.

    The other columns have names defined by pssf:

    - XRKL_READ, grade of the simulated reader; absent without a simulated reader.
    - jsw_medial_mm (equal to MCMJSW) and jsw_lateral_mm, minimum joint space widths in the radiograph.
    - nominal_jsw_medial_mm and nominal_jsw_lateral_mm, joint space widths in the specification of the knee.
    - inter_margin_mm, height of the anterior margin of the medial plateau above its posterior margin. The OAI column
      TPCFDS, the distance from plateau to rim, is unsigned.
    - attrition depths in mm, femorotibial angle, tibial slope and Insall-Salvati ratio (`model.limb_axes`).

    ``landmarks/*.pts`` contains the sixteen contour landmarks, and ``coco.json`` contains the same landmarks as COCO
    keypoints. ``images/GRADE/*.png`` contains 8-bit images processed for display, in the layout of torchvision's
    ImageFolder.
    """
    cohort, out = Path(cohort), Path(out)
    if out.resolve() == cohort.resolve():
        raise InputError(f"out must differ from the cohort folder, got {out}")
    manifest = cohort / "manifest.csv"
    if not manifest.exists():
        raise InputError(f"folder must contain a completed cohort with manifest.csv, got {cohort}")
    listed = read_csv(manifest, ("radiograph", "subject", "file"))
    # All radiographs are checked before the first file is written, so that no export is incomplete.
    for made in listed:
        _require_contours(cohort, made["file"])
    make_folder(out)
    rows, images = [], []
    for made in listed:
        radiograph = load(cohort / made["file"])
        knee, truth = radiograph.knee, radiograph.truth
        assert knee is not None
        assert truth is not None
        places = {name: truth.landmarks_px[name] for name in CONTOUR_LANDMARKS}
        rows.append(_make_readings_row(made["radiograph"], str(made["subject"]), knee, truth))
        write_pts(make_folder(out / "landmarks") / f"{made['radiograph']}.pts", places)
        picture = f"{'none' if truth.grade is None else truth.grade}/{made['radiograph']}.png"
        write_image_row(
            [render_for_display(radiograph, processing="processed").astype(np.uint8)],
            make_folder((out / "images" / picture).parent) / f"{made['radiograph']}.png",
        )
        size = radiograph.pixels.shape
        known = {"kl": truth.grade, "jsw_medial_mm": truth.jsw_medial_mm, "jsw_lateral_mm": truth.jsw_lateral_mm}
        images.append(LabelledImage(file=picture, rows=size[0], cols=size[1], landmarks_px=places, attributes=known))
    write_csv(out / "readings.csv", rows)
    return [out / "readings.csv", write_coco(out / "coco.json", images), out / "landmarks", out / "images"]


def _require_contours(cohort: Path, file: str) -> None:
    """Require that a radiograph shows one knee in a frontal view, with its contour landmarks."""
    made = load_parameters(cohort / file)
    if made["knee"] is None or made["truth"] is None:
        raise InputError(f"file {file} must be a radiograph of one knee, got a radiograph without a knee")
    if not set(CONTOUR_LANDMARKS) <= set(made["truth"].landmarks_px):
        seen = made["protocol"].projection
        raise InputError(f"file {file}: projection must be AP or PA to show the contour landmarks, got {seen!r}")


def _make_readings_row(name: str, subject: str, knee: Knee, truth: Truth) -> dict[str, Any]:
    """Build the row of readings.csv for one radiograph."""
    spaces = {f"{'JSW' if at < 0.5 else 'LJSW'}{round(1000 * at)}": round(mm, 4) for at, mm in truth.jsw_at_mm.items()}
    return {
        "ID": subject,
        "SIDE": _SIDE_CODES[knee.side],
        "radiograph": name,
        **({} if truth.reader_grade is None else {"XRKL_READ": truth.reader_grade}),
        **{name: value for name, value in truth.readings.items() if name.startswith("XR")},
        "HKANGLE": round(STRAIGHT_LEG_DEG - truth.readings["hip_knee_ankle_deg"], 4),
        "MCMJSW": truth.jsw_medial_mm,
        **spaces,
        "jsw_medial_mm": truth.jsw_medial_mm,
        "jsw_lateral_mm": truth.jsw_lateral_mm,
        "nominal_jsw_medial_mm": round(knee.jsw_medial_mm, 4),
        "nominal_jsw_lateral_mm": round(knee.jsw_lateral_mm, 4),
        **{f"attrition_{side}_mm": depth for side, depth in truth.attrition_mm.items()},
        **{
            name: value
            for name, value in truth.readings.items()
            if not name.startswith("XR") and name not in _OAI_RENAMED_READINGS
        },
    }
