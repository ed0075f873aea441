"""Comparison of bones: registration, surface distances, measures of form, and figures."""
