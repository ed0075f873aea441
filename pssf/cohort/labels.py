"""write_labels: a cohort -> its labels in the formats that the field reads."""

from pathlib import Path
from typing import Any

import numpy as np

from ..anatomy.landmarks import CONTOUR_LANDMARKS
from ..core.checks import InputError
from ..detector.rendering import present
from ..io.atomic import folder
from ..io.images import load, load_parameters
from ..io.labels import LabelledImage, write_coco, write_pts
from ..io.pictures import side_by_side
from ..io.records import read_csv, write_csv
from ..model.axes import STRAIGHT_DEG
from ..model.knee import Knee
from ..model.radiograph import Truth

_SIDE = {"right": 1, "left": 2}
# Told by the Initiative's name and way to count.
_RENAMED = ("hip_knee_ankle_deg",)


def write_labels(cohort: str | Path, out: str | Path) -> list[Path]:
    """Labels of all radiographs of a cohort, and pictures for eyes sorted by grade.

    readings.csv       a row a radiograph, columns as the Osteoarthritis Initiative names them in its readings of knee
                       and leg radiographs (there with a visit before them, V00MCMJSW): ID, SIDE (1 right, 2 left), XRKL
                       and the OARSI grades (`oarsi`), HKANGLE (hip, knee and ankle, deg; varus is negative), MCMJSW
                       (least medial space), JSW150 to JSW300 (medial) and LJSW700 to LJSW900 (lateral), mm. By names of
                       our own: XRKL_READ, where a reader is sampled; the minimum joint spaces of this radiograph
                       (jsw_medial_mm, which is MCMJSW, and jsw_lateral_mm) and those that the knee was specified with
                       (nominal_jsw_medial_mm, nominal_jsw_lateral_mm); how far the front margin of the medial plateau
                       is above its back one (inter_margin_mm; its TPCFDS, from plateau to rim, has no sign), depths of
                       attrition (mm), femorotibial angle, slope and patellar height (`axes`)
    landmarks/*.pts    the sixteen contour landmarks
    coco.json          the same as COCO keypoints
    images/GRADE/*.png 8 bit, for eyes, as torchvision's ImageFolder and others read them

    cohort  folder that `make_cohort` has filled
    out     another folder
    raises  InputError for a folder that holds no whole cohort, the cohort's own for `out`, or a disk that is full or
            cannot be written
    """
    cohort, out = Path(cohort), Path(out)
    if out.resolve() == cohort.resolve():
        raise InputError(f"out = {out}, the cohort's own folder; allowed: another one")
    manifest = cohort / "manifest.csv"
    if not manifest.exists():
        raise InputError(f"folder {cohort}: no manifest.csv; allowed: a cohort that is made")
    listed = read_csv(manifest, ("radiograph", "subject", "file"))
    # Before anything is written: what a radiograph lacks is told of the first one, not half way.
    for made in listed:
        _require_contours(cohort, made["file"])
    folder(out)
    rows, images = [], []
    for made in listed:
        radiograph = load(cohort / made["file"])
        knee, truth = radiograph.knee, radiograph.truth
        assert knee is not None
        assert truth is not None
        places = {name: truth.landmarks_px[name] for name in CONTOUR_LANDMARKS}
        rows.append(_reading(made["radiograph"], str(made["subject"]), knee, truth))
        write_pts(folder(out / "landmarks") / f"{made['radiograph']}.pts", places)
        picture = f"{'none' if truth.grade is None else truth.grade}/{made['radiograph']}.png"
        side_by_side(
            [present(radiograph, look="processed").astype(np.uint8)],
            folder((out / "images" / picture).parent) / f"{made['radiograph']}.png",
        )
        size = radiograph.pixels.shape
        known = {"kl": truth.grade, "jsw_medial_mm": truth.jsw_medial_mm, "jsw_lateral_mm": truth.jsw_lateral_mm}
        images.append(LabelledImage(file=picture, rows=size[0], cols=size[1], places=places, attributes=known))
    write_csv(out / "readings.csv", rows)
    return [out / "readings.csv", write_coco(out / "coco.json", images), out / "landmarks", out / "images"]


def _require_contours(cohort: Path, file: str) -> None:
    made = load_parameters(cohort / file)
    if made["knee"] is None or made["truth"] is None:
        raise InputError(f"file {file}: no knee; allowed: radiographs of a cohort")
    if not set(CONTOUR_LANDMARKS) <= set(made["truth"].landmarks_px):
        seen = made["protocol"].projection
        raise InputError(f"file {file}: projection = {seen!r}; allowed: AP or PA, which show the contours")


def _reading(name: str, subject: str, knee: Knee, truth: Truth) -> dict[str, Any]:
    spaces = {f"{'JSW' if at < 0.5 else 'LJSW'}{round(1000 * at)}": round(mm, 4) for at, mm in truth.jsw_at_mm.items()}
    return {
        "ID": subject,
        "SIDE": _SIDE[knee.side],
        "radiograph": name,
        **({} if truth.grade_read is None else {"XRKL_READ": truth.grade_read}),
        **{name: value for name, value in truth.readings.items() if name.startswith("XR")},
        "HKANGLE": round(STRAIGHT_DEG - truth.readings["hip_knee_ankle_deg"], 4),
        "MCMJSW": truth.jsw_medial_mm,
        **spaces,
        "jsw_medial_mm": truth.jsw_medial_mm,
        "jsw_lateral_mm": truth.jsw_lateral_mm,
        "nominal_jsw_medial_mm": round(knee.jsw_medial_mm, 4),
        "nominal_jsw_lateral_mm": round(knee.jsw_lateral_mm, 4),
        **{f"attrition_{side}_mm": depth for side, depth in truth.attrition_mm.items()},
        **{name: value for name, value in truth.readings.items() if not name.startswith("XR") and name not in _RENAMED},
    }
