"""Radiographs of the patient comparison: simulation, normalisation, features, and tests against patient radiographs."""
