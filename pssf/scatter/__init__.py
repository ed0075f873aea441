"""Scattered radiation: Monte Carlo simulation, a fast kernel fitted to it, and anti-scatter grids.

scatter_kernel       fast scatter model, fitted to Monte Carlo results
monte_carlo          Monte Carlo estimate of the scatter
photon_interactions  tables of the interactions of photons with matter
photon_transport     transport of individual photons through voxels
voxel_grid           conversion of a scene to a grid of materials
antiscatter_grid     transmission of an anti-scatter grid
"""
