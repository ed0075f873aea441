"""Comparison of simulated knees with patients: contour landmarks, bones and radiographs, on one page.

``comparison_run``
    Run the comparison and write its page, tables and figures.
``contours``
    Compare contour landmarks of simulated knees with published landmarks of patients.
``bones``
    Compare simulated bones with patient bones: surface distances, spread and bone shape.
``films``
    Compare simulated with patient radiographs: normalisation, bone outlines, image features and classifiers.

Figures need the optional dependencies ``study``.
"""
