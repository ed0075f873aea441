"""What reaches the detector by another way than the straight one.

kernel        fitted to the Monte Carlo; fast
monte_carlo   photons followed one by one through voxels
interactions  what they do in matter
transport     the walk itself
voxels        a scene as a grid of materials
grid          strips of lead against it
"""
