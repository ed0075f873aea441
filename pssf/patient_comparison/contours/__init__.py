"""Comparison of contour landmarks with published landmarks of patients."""
