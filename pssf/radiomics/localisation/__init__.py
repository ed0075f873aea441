"""Localisation of the medial joint line in radiographs by correlation of image edges with template edges."""
