"""Training and prediction from features: splits, feature selection, classifiers, baselines and scenarios."""
