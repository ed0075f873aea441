"""Scattered radiation: Monte Carlo simulation, a fast kernel fitted to Monte Carlo results, and anti-scatter grids.

Modules:

- `scatter_kernel`: fast scatter model, fitted to Monte Carlo results.
- `monte_carlo`: Monte Carlo estimate of the scatter.
- `photon_transport`: transport of individual photons through voxels.
- `voxel_grid`: conversion of a scene to a voxel grid of materials.
- `antiscatter_grid`: transmission of an anti-scatter grid.
"""
