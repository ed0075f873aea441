"""Statistics of features: degenerate features, reliability, localisation error, importance and dimensions."""
