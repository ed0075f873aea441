"""Compare simulated with patient bones: registration, surface distances, shape measures and figures."""
