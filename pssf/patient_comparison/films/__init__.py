"""Compare simulated with patient radiographs: simulation, normalisation, features and classifiers."""
