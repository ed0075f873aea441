"""Comparison of simulated knees with patients: contour landmarks, bones and radiographs, on one page.

``comparison_run``
    Run the comparison and write its page, tables and figures.
``contours``
    Compare contour landmarks of simulated knees with published landmarks of patients.
``bones``
    Compare built and sampled bones with patient bones: distances, spread and measures of form.
``films``
    Compare simulated with patient radiographs: normalisation, outlines, features, and models.
``shape_model``
    Fit the shape modes in ``data/shapes.toml`` to patient bones.

Figures need the extra ``study``.
"""
