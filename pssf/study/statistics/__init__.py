"""Statistics of predictions and features: estimates with 95 % intervals."""
