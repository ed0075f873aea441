"""Definition of the benchmark data set (``data/benchmark.toml``) and hashes of its images."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Record, parse_record


class BenchmarkDefinition(Record, frozen=True):
    """Definition and citation of the benchmark data set, which does not change after its release.

    Attributes
    ----------
    preset : str
        Name of the cohort preset.
    seed : int
        Seed of the cohort.
    splits : int
        Number of fixed splits by subject.
    version : str
        Version of the data set.
    title : str
        Title of the data set.
    description : str
        Description of the data set.
    keywords : tuple of str
        Keywords of the data set.
    date : str
        Date of release, YYYY-MM-DD.
    license : str
        Web address of the licence.
    creator : str
        Creator of the data set.
    url : str
        Web address of a page about the data set.
    """

    preset: str
    seed: int
    splits: int
    version: str
    title: str
    description: str
    keywords: tuple[str, ...]
    date: str
    license: str
    creator: str
    url: str


@cache
def load_benchmark_definition() -> BenchmarkDefinition:
    """Load the definition of the benchmark data set.

    Returns
    -------
    BenchmarkDefinition
        Content of ``data/benchmark.toml``.
    """
    return parse_record(BenchmarkDefinition, load_data_table("benchmark"), "benchmark")


@cache
def load_benchmark_hashes() -> dict[str, str]:
    """Load the image hashes of the benchmark data set.

    Returns
    -------
    dict of str to str
        SHA-256 hash of the pixels of all radiographs of a subject, keyed by the subject's number (see
        `benchmark.image_hashes`). Only selected subjects are listed.
    """
    return parse_record(dict[str, dict[str, str]], load_data_table("benchmark_hashes"), "benchmark_hashes")["sha256"]
