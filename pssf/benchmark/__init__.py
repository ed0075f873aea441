"""Benchmark: a frozen data set with fixed splits and baselines, so that papers can be compared.

benchmark_maker  folder            -> images, splits, features, baselines, and the documents below
image_hashes     images            -> one hash per subject, compared with the hashes that the package publishes
datasheet        content           -> datasheet (Gebru et al. 2021) and citation file
croissant        files             -> Croissant 1.0 metadata, for programs that load data sets
"""

from .benchmark_maker import BenchmarkResult, make_benchmark

__all__ = ["BenchmarkResult", "make_benchmark"]
