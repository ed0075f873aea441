"""Cohorts: plan knees and radiographs, make the radiographs, export labels, and verify files.

plan_cohort      preset, seed    -> Plan: knees, subjects, and the radiographs of each knee
select_subjects  Plan            -> Plan with a selection of subjects, equally many per grade
plan_retest      Plan            -> Plan of repeated radiographs of some knees, with new noise and new positioning
make_cohort      Plan, folder    -> images and a manifest; continues where an earlier run stopped
write_labels     folder          -> labels as OAI columns, .pts files and COCO keypoints, and images sorted by grade
verify_cohort    folder          -> list of missing, changed and extra files

The folder of a cohort has cohort.json (the specification), images/*.tif, and one file records/*.json per knee, which is
written after the images of the knee. A finished cohort also has manifest.csv with one row per radiograph.
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
