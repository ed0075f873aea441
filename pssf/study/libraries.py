"""Names of distributions that depend on the platform."""

import sys

# The CPU build of xgboost has no wheels for macOS; the standard build has no GPU code there.
XGBOOST = "xgboost" if sys.platform == "darwin" else "xgboost-cpu"
