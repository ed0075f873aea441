"""Estimate run time, disk space and number of files of a data set before it is made."""

import time
from dataclasses import dataclass

from .dataset_plan import count_parts
from .dataset_settings import DatasetSettings
from .dataset_tables import load_dataset_tables
from .sample_files import encode_sample
from .subject_samples import make_subject_samples

# Number of subjects that are simulated to measure the cost, besides one that is not measured.
_MEASURED_SUBJECTS = 5


@dataclass(frozen=True, kw_only=True)
class CostEstimate:
    """Estimated cost of a data set on this machine.

    Attributes
    ----------
    images : int
        Number of images.
    files : int
        Number of files, including the records of the parts.
    disk_mb : float
        Size of the images and labels, in MB.
    cpu_seconds : float
        CPU time of all images, in s.
    measured_images : int
        Number of images from which the cost was extrapolated.
    """

    images: int
    files: int
    disk_mb: float
    cpu_seconds: float
    measured_images: int


def estimate_cost(settings: DatasetSettings) -> CostEstimate:
    """Estimate the cost of a data set from a few of its images, which are simulated on this machine.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.

    Returns
    -------
    CostEstimate
        Cost of the complete data set.

    Raises
    ------
    InputError
        If a table or protocol is unknown.

    Notes
    -----
    In a balanced data set, the first subjects have all KL grades. Knees with osteophytes take longer, so
    the estimate of a data set with other frequencies of the grades is less exact.
    """
    tables, sizes, seconds, made = load_dataset_tables(settings), list[int](), 0.0, 0
    for subject in range(min(settings.subject_count, _MEASURED_SUBJECTS) + 1):
        before = time.process_time()
        samples = make_subject_samples(settings, tables, max(subject - 1, 0), "train")
        files = [file for sample in samples for file in encode_sample(sample, settings, tables)]
        # The first subject is simulated twice, because the first simulation of a process also loads code and tables.
        if subject:
            seconds += time.process_time() - before
            sizes += [len(content) for _, content in files]
            made += len(samples)
    images = settings.subject_count * settings.images_per_subject
    parts = count_parts(settings)
    files_made = 2 * parts if settings.layout == "shards" else len(sizes) * images // made + parts
    return CostEstimate(
        images=images,
        files=files_made,
        disk_mb=sum(sizes) / made * images / 1e6,
        cpu_seconds=seconds / made * images,
        measured_images=made,
    )
