"""Localisation of the medial joint line in radiographs, by the correlation of edges with templates."""
