"""Meshes and scenes on disk: reading of meshes of any program, export, and a 3D viewer page."""
