"""Compare simulated knees with patients: contour landmarks, bones and radiographs.

``comparison_run``
    Run the comparison and write an HTML page with tables and figures.
``contours``
    Compare contour landmarks of simulated knees with published landmarks of patients.
``bones``
    Compare simulated bones with patient bones: surface distances, variability and bone shape.
``films``
    Compare simulated with patient radiographs: normalisation, bone outlines, image features and classifiers.

Figures require the optional dependencies ``study``.
"""
