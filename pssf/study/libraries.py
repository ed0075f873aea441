"""Names of Python distributions that depend on the platform."""

import sys

# The distribution xgboost-cpu has no wheels for macOS. The wheels of xgboost for macOS contain no GPU code.
XGBOOST = "xgboost" if sys.platform == "darwin" else "xgboost-cpu"
