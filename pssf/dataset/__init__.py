"""Make data sets of labelled images for networks: planning, simulation, crops, randomisation and label maps.

DatasetSettings -> plan_subject -> make_sample -> randomise -> files of `make_dataset`, or a stream of samples.
"""

from .cost_estimate import CostEstimate, estimate_cost
from .dataset_maker import make_dataset
from .dataset_plan import PlannedImage, count_parts, plan_subject
from .dataset_settings import DatasetSettings
from .dataset_tables import DatasetTables, load_dataset_tables
from .dataset_verification import verify_dataset
from .randomisation import RECIPES, TRANSFORMS, randomise
from .sample import Sample, make_sample
from .subject_samples import make_subject_samples

__all__ = [
    "RECIPES",
    "TRANSFORMS",
    "CostEstimate",
    "DatasetSettings",
    "DatasetTables",
    "PlannedImage",
    "Sample",
    "count_parts",
    "estimate_cost",
    "load_dataset_tables",
    "make_dataset",
    "make_sample",
    "make_subject_samples",
    "plan_subject",
    "randomise",
    "verify_dataset",
]
