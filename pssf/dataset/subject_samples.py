"""Make the images of one subject, including their randomisation."""

from dataclasses import replace

from ..core.checks import InputError
from ..core.random_streams import make_stream
from .dataset_plan import PlannedImage, plan_subject
from .dataset_settings import DatasetSettings
from .dataset_tables import DatasetTables
from .randomisation import randomise
from .sample import RANDOMISE_KEY, Sample, make_sample

# Maximum number of attempts to sample buildable knees of a subject. All of 2,000 sampled knees could be built (table
# `builds`), so a second attempt is rare.
_ATTEMPTS = 5


def make_subject_samples(settings: DatasetSettings, tables: DatasetTables, subject: int, split: str) -> list[Sample]:
    """Simulate the images of a subject, and apply the transforms of the data set.

    Parameters
    ----------
    settings : DatasetSettings
        Settings of the data set.
    tables : DatasetTables
        Result of `load_dataset_tables`.
    subject : int
        Number of the subject.
    split : str
        Subset to which the subject belongs.

    Returns
    -------
    list of Sample
        Images with their labels.

    Raises
    ------
    InputError
        If no attempt gives knees that can be built.

    Notes
    -----
    If a knee cannot be built, all knees of the subject are sampled again with the same grade. The label ``attempt`` is
    then greater than 0.
    """
    for attempt in range(_ATTEMPTS):
        try:
            planned = plan_subject(settings, tables, subject, split, attempt=attempt)
            return [_make_randomised_sample(image, settings, tables, attempt) for image in planned]
        except InputError:
            if attempt == _ATTEMPTS - 1:
                raise
    raise AssertionError("unreachable")


def _make_randomised_sample(
    planned: PlannedImage, settings: DatasetSettings, tables: DatasetTables, attempt: int
) -> Sample:
    """Simulate a planned image, and apply the transforms of the data set."""
    sample = make_sample(planned, settings, tables)
    sample = replace(sample, labels={**sample.labels, "attempt": attempt})
    if not settings.randomise:
        return sample
    return randomise(
        sample, settings.randomise, make_stream(planned.appearance_seed, RANDOMISE_KEY), tables.definitions.label_map
    )
