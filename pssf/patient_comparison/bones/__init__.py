"""Comparison of simulated with patient bones: registration, surface distances, bone shape and figures."""
