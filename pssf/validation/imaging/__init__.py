"""Validation of the imaging chain: spectrum, scatter, focal spot and views; error and run time of each stage."""
