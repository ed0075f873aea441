"""Package name of XGBoost on PyPI, which depends on the operating system."""

import sys

# The package xgboost-cpu has no wheels for macOS; the macOS wheels of xgboost contain no GPU code.
XGBOOST = "xgboost" if sys.platform == "darwin" else "xgboost-cpu"
