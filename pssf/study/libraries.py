"""Distributions whose name depends on the platform."""

import sys

# The CPU build of xgboost has no wheels for macOS, where the plain one brings nothing for GPUs.
XGBOOST = "xgboost" if sys.platform == "darwin" else "xgboost-cpu"
