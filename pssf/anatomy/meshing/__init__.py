"""Meshing: closed triangle meshes and solids from implicit shapes, lofts, remeshing and noise fields."""
