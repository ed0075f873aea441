"""Read meshes of any program, read and export scenes, and write a 3D viewer page."""
