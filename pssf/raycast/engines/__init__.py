"""Ray casting engines: projection of surfaces, crossings of rays, and integrals along rays.

Modules:

- `projected_surface`: projection of a surface onto the detector, sorted into bands of rows.
- `triangle_clipping`: removal of surface parts behind the source.
- `pixel_rays`: directions and lengths of rays, and ray lengths inside a box.
- `crossings`: crossings along each ray, chords and density integrals.
- `scanline`: engine that projects triangles and sums their signed depths in float64.
- `embree`: engine that casts rays with Embree in float32 and recomputes unreliable rays in float64.
- `ray_state`: state of the rays that are being cast.
- `neighbour_reuse`: reuse of the triangles of neighbouring pixels.
- `sparse_map`: path length maps that do not store the air beside the object.
"""
