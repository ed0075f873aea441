"""Trabecular bone: density of each bone, strut lattice and integrals of density along rays."""
