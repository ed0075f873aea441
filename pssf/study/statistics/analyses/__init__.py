"""Analyses of predictions and features.

They cover leakage, incremental value, learning curves, response curves, sensitivity and confounding.
"""
