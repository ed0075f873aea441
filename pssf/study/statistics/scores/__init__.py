"""Scores of predictions: metrics, 95 % intervals, calibration, subgroups and claims."""
