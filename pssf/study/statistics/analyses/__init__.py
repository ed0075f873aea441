"""Analyses of predictions and features.

The analyses cover leakage, incremental value, learning curves, response curves, sensitivity and confounding.
"""
