"""Compare contour landmarks of simulated knees with published landmarks of patients."""
