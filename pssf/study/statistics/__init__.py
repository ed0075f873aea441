"""Statistics of predictions and features, with 95 % intervals."""
