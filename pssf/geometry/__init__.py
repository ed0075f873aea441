"""Where things are.

view      source, rays and pixels in the knee frame
scene     closed surfaces between materials
density   what varies within a material
repair    what is wrong with a mesh, mended or refused
topology  meshes as numbers
"""

from .view import View, magnification, project, view_of

__all__ = ["View", "magnification", "project", "view_of"]
