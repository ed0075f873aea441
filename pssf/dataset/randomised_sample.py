"""Make one image of a data set, including its randomisation."""

from .dataset_plan import PlannedImage
from .dataset_settings import DatasetSettings
from .dataset_tables import DatasetTables
from .randomisation import randomise
from .sample import RANDOMISE_KEY, Sample, make_sample, make_stream


def make_randomised_sample(
    planned: PlannedImage, settings: DatasetSettings, tables: DatasetTables, *, repeat: int = 0
) -> Sample:
    """Simulate a planned image, and apply the transforms of the data set.

    Parameters
    ----------
    planned : PlannedImage
        Knee, protocol and seed of the image.
    settings : DatasetSettings
        Settings of the data set.
    tables : DatasetTables
        Result of `load_dataset_tables`.
    repeat : int
        Number of the randomisation; other numbers give other random transforms of the same image.

    Returns
    -------
    Sample
        Image with its labels.

    Raises
    ------
    InputError
        If the knee cannot be built.
    """
    sample = make_sample(planned, settings, tables)
    if not settings.randomise:
        return sample
    return randomise(sample, settings.randomise, make_stream(planned.seed, RANDOMISE_KEY, repeat))
