"""Feature selection, classifiers, baselines, a small network, and model files."""
