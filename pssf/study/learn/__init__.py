"""From features to predictions: splits, selections, models, baselines, scenarios."""
