"""Plan cohorts of knees, make their radiographs, export their labels, and verify their files.

plan_cohort      preset, seed    -> Plan: knees, subjects, and the radiographs of each knee
select_subjects  Plan            -> Plan with a subset of the subjects, the same number per grade
plan_retest      Plan            -> Plan of repeat radiographs of selected knees, with new noise or new positioning
make_cohort      Plan, folder    -> images and a manifest; an interrupted run is resumed
write_labels     folder          -> labels as OAI columns, .pts files and COCO keypoints, and images sorted by grade
verify_cohort    folder          -> list of missing, changed and extra files

A cohort folder contains cohort.json (the specification), images/*.tif, and one file records/*.json per knee. The record
of a knee is written after its images. A completed cohort also contains manifest.csv, with one row per radiograph.
"""

from .cohort_maker import make_cohort
from .cohort_plan import (
    Case,
    Exposure,
    Plan,
    plan_cohort,
    preset_names,
    select_subjects,
)
from .label_export import write_labels
from .retest_plan import plan_retest
from .verification import Verification, verify_cohort

__all__ = [
    "Case",
    "Exposure",
    "Plan",
    "Verification",
    "make_cohort",
    "plan_cohort",
    "plan_retest",
    "preset_names",
    "select_subjects",
    "verify_cohort",
    "write_labels",
]
