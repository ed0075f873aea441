"""Predictions for patient radiographs, and features of a user's own images."""
