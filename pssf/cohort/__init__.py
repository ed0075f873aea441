"""cohort.plan_cohort   preset, seed    -> who is in it, and how each knee is taken
cohort.some_people   plan            -> some of its people, of the grades alike
cohort.plan_retest   plan            -> some of its knees, to be taken again with other noise and placed anew
cohort.make_cohort   plan, folder    -> images and a manifest; goes on where an earlier run stopped
cohort.write_labels  folder          -> its labels as the field reads them: OAI columns, .pts, COCO, pictures by grade
cohort.verify_cohort folder          -> every file against its hash, and what is missing, changed or too much

A cohort's folder holds cohort.json (what was asked for), images/*.tif, records/*.json (one a knee, written after its
images) and, when all is made, manifest.csv with one row a radiograph.
"""

from .labels import write_labels
from .make import make_cohort
from .plan import Case, Exposure, Plan, plan_cohort, preset_names, some_people
from .retest import plan_retest
from .verify import Verification, verify_cohort

__all__ = [
    "Case",
    "Exposure",
    "Plan",
    "Verification",
    "make_cohort",
    "plan_cohort",
    "plan_retest",
    "preset_names",
    "some_people",
    "verify_cohort",
    "write_labels",
]
