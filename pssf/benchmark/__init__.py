"""A frozen data set, so that two papers can compare: images by one command, and with them what a reader needs.

make       folder                       -> images, splits, features, baselines, and all below
hashes     images                       -> a hash for each person, beside those that the package has written down
datasheet  what is in it                -> datasheet (Gebru 2021), citation
croissant  files of the folder          -> Croissant 1.0, for programs that load data sets
"""

from .make import BenchmarkResult, make_benchmark

__all__ = ["BenchmarkResult", "make_benchmark"]
