"""Validation of simulated knees: build success, bone sizes and trabecular texture."""
