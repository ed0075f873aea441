"""Feature selection, classifiers, baselines, a small network, and models as files."""
