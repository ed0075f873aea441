"""Trabecular bone: density of each bone, strut lattice and density integrals along rays."""
