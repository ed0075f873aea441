"""Closed triangle meshes and solids: implicit shapes, lofts, remeshing, noise fields."""
