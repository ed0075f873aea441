"""Scattered radiation: Monte Carlo, the kernel fitted to it, and anti-scatter grids.

scatter_kernel       fast scatter model, fitted to the Monte Carlo
monte_carlo          Monte Carlo estimate of the scatter
photon_interactions  tables of the interactions of photons with matter
photon_transport     transport of single photons through voxels
voxel_grid           scene as a grid of materials
antiscatter_grid     transmission of an anti-scatter grid
"""
