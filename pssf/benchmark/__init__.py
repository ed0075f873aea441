"""Benchmark: a frozen data set with fixed splits and baselines, so that results of different papers are comparable.

benchmark_maker  output folder     -> images, splits, features, baselines, and all documents
image_hashes     images            -> one hash per subject, for comparison with the published hashes
datasheet        DatasheetContent  -> datasheet (Gebru et al. 2021) and citation file
croissant        CSV files         -> Croissant 1.0 metadata, for programs that load data sets
"""

from .benchmark_maker import BenchmarkResult, make_benchmark

__all__ = ["BenchmarkResult", "make_benchmark"]
