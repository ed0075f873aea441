"""Read meshes and scenes, export scenes as mesh files, and write a 3D viewer page."""
