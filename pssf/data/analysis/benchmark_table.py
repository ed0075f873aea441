"""Definition of the benchmark data set (``data/benchmark.toml``) and hashes of its images."""

from functools import cache

from ..data_files import load_data_table
from ..table_records import Record, parse_record


class BenchmarkDefinition(Record, frozen=True):
    """Definition and citation of a data set that one command makes and that never changes.

    Attributes
    ----------
    preset : str
        Name of the cohort preset.
    seed : int
        Seed of the cohort.
    splits : int
        Number of fixed splits by person.
    version : str
        Version of the data set.
    title : str
        Title.
    description : str
        Description.
    keywords : tuple of str
        Keywords.
    date : str
        Date of release, YYYY-MM-DD.
    license : str
        Address of the licence.
    creator : str
        Creator.
    url : str
        Address of a page about the data set.
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
        Person -> SHA-256 hash of the pixels of all radiographs of the person, as in `benchmark.image_hashes`. Only some
        persons are listed.
    """
    return parse_record(dict[str, dict[str, str]], load_data_table("benchmark_hashes"), "benchmark_hashes")["sha256"]
