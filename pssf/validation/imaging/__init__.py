"""Validation of the imaging chain: spectrum, scatter, focal spot, views, and error and run time of each stage."""
