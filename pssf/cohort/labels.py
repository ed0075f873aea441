"""write_labels: a cohort -> its labels in the formats that the field reads."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ..anatomy.attrition import outer_bones
from ..anatomy.bone_build import build_of
from ..anatomy.joint import KneeAssembly, assemble, defining_protocol
from ..anatomy.landmarks import CONTOUR_LANDMARKS
from ..anatomy.plateau import inter_margin_mm
from ..core.checks import InputError
from ..data.anatomy import AnatomyTables, anatomy_tables
from ..data.bones import FemurShape, mean_shape
from ..data.oarsi import OarsiCuts, oarsi_cuts
from ..data.spongy import TrabecularBone, trabecular_bone
from ..detector.rendering import for_eyes
from ..geometry.mesh import Mesh
from ..io.atomic import folder
from ..io.images import load
from ..io.labels import LabelledImage, write_coco, write_pts
from ..io.pictures import side_by_side
from ..io.records import read_csv, write_csv
from ..model.axes import axes
from ..model.knee import Knee
from ..model.oarsi import oarsi
from ..model.protocol import Posture
from ..model.radiograph import Radiograph

_SIDE = {"right": 1, "left": 2}


def write_labels(cohort: str | Path, out: str | Path) -> list[Path]:
    """Labels of all radiographs of a cohort, and pictures for eyes sorted by grade.

    readings.csv       a row a radiograph, columns as the Osteoarthritis Initiative names them in its readings of knee
                       radiographs (kxr_sq_bu, kxr_qjsw_duryea; there with a visit before them, V00MCMJSW): ID, SIDE
                       (1 right, 2 left), XRKL and the OARSI grades (`oarsi`), MCMJSW (least medial space), JSW150 to
                       JSW300 (medial) and LJSW700 to LJSW900 (lateral), mm; by names of our own, since it has none for
                       them: XRKL_READ, where a reader is drawn, the least lateral space (jsw_lateral_mm), how far the
                       front margin of the medial plateau stands over its back one (inter_margin_mm; its TPCFDS, from
                       plateau to rim, has no sign), depths of attrition (mm), femorotibial angle, slope and patellar
                       height (`axes`)
    landmarks/*.pts    the sixteen contour landmarks
    coco.json          the same as COCO keypoints
    images/GRADE/*.png 8 bit, for eyes, as torchvision's ImageFolder and others read them

    cohort  folder that `make_cohort` has filled
    raises  InputError for a folder that holds no whole cohort, or a disk that is full or cannot be written
    """
    cohort, out = Path(cohort), folder(Path(out))
    rows, images = [], []
    # Radiographs of a knee follow one another.
    stand = lru_cache(maxsize=1)(partial(_stand, anatomy_tables()))
    readers = _Readers(cuts=oarsi_cuts(), spongy=trabecular_bone(), femur=mean_shape().femur, stand=stand)
    manifest = cohort / "manifest.csv"
    if not manifest.exists():
        raise InputError(f"folder {cohort}: no manifest.csv; allowed: a cohort that is made")
    for made in read_csv(manifest, ("radiograph", "subject", "file")):
        radiograph = load(cohort / made["file"])
        if radiograph.knee is None or radiograph.truth is None:
            raise InputError(f"file {made['file']}: no knee; allowed: radiographs of a cohort")
        if not set(CONTOUR_LANDMARKS) <= set(radiograph.truth.landmarks_px):
            seen = radiograph.protocol.projection
            raise InputError(f"file {made['file']}: projection = {seen!r}; allowed: AP or PA, which show the contours")
        places = {name: radiograph.truth.landmarks_px[name] for name in CONTOUR_LANDMARKS}
        rows.append(_reading(made["radiograph"], str(made["subject"]), radiograph, readers))
        write_pts(folder(out / "landmarks") / f"{made['radiograph']}.pts", places)
        grade = radiograph.truth.grade
        picture = f"{'none' if grade is None else grade}/{made['radiograph']}.png"
        side_by_side(
            [for_eyes(radiograph).astype(np.uint8)],
            folder((out / "images" / picture).parent) / f"{made['radiograph']}.png",
        )
        size = radiograph.pixels.shape
        images.append(LabelledImage(file=picture, rows=size[0], cols=size[1], places=places, grade=grade))
    if not rows:
        raise InputError(f"folder {cohort}: no radiographs; allowed: a cohort that is made")
    write_csv(out / "readings.csv", rows)
    return [out / "readings.csv", write_coco(out / "coco.json", images), out / "landmarks", out / "images"]


@dataclass(frozen=True, kw_only=True)
class _Readers:
    """What knees are graded and measured by; `stand` gives how one stands, and its tibia."""

    cuts: OarsiCuts
    spongy: TrabecularBone
    femur: FemurShape
    stand: Callable[[Knee, Posture], tuple[KneeAssembly, Mesh]]


def _stand(tables: AnatomyTables, knee: Knee, posture: Posture) -> tuple[KneeAssembly, Mesh]:
    assembly = assemble(knee, build_of(knee, tables), posture, defining_protocol(knee))
    return assembly, outer_bones(assembly)[1]


def _reading(name: str, subject: str, radiograph: Radiograph, by: _Readers) -> dict[str, Any]:
    knee, truth = radiograph.knee, radiograph.truth
    assert knee is not None
    assert truth is not None
    protocol = radiograph.protocol
    spaces = {f"{'JSW' if at < 0.5 else 'LJSW'}{round(1000 * at)}": round(mm, 4) for at, mm in truth.jsw_at_mm.items()}
    return {
        "ID": subject,
        "SIDE": _SIDE[knee.side],
        "radiograph": name,
        **({} if knee.grade_read is None else {"XRKL_READ": knee.grade_read}),
        **oarsi(knee, truth.attrition_mm, by.cuts, by.spongy),
        "MCMJSW": round(truth.jsw_medial_mm, 4),
        **spaces,
        "jsw_lateral_mm": round(truth.jsw_lateral_mm, 4),
        "inter_margin_mm": round(inter_margin_mm(*by.stand(knee, protocol.posture), protocol), 4),
        **{f"attrition_{side}_mm": depth for side, depth in truth.attrition_mm.items()},
        **axes(knee, by.femur),
    }
