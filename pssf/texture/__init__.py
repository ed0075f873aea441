"""Texture of trabecular bone in radiographs, as research on osteoarthritis measures it.

fractal_signature     fractal signature by dilation and erosion with rods (Lynch 1991)
orientation_transforms
                      variance and Hurst orientation transforms (Wolski 2009, Podsiadlo 2002)
directional_variogram mean square of grey-value differences by direction and distance
rod_ranges            mean range of grey values along rods
rose_ellipse          ellipse of a rose plot
binary_patterns       local binary patterns (Ojala 2002)
directional_spectrum  slope of the power spectrum by direction
scaling_laws          slopes of log-log curves, by scale and over all scales
texture_scales        scales in mm, and checks of images and masks
texture_regions       regions of the tibia from landmarks
texture_features      features of all measures, with names
"""

from .binary_patterns import local_binary_patterns
from .directional_spectrum import spectral_slope
from .fractal_signature import FractalSignature, fractal_signature
from .orientation_transforms import (
    OrientationSignature,
    hurst_orientation_transform,
    variance_orientation_transform,
)
from .texture_features import TEXTURE_FAMILIES, measure_texture_features, mirror_texture_features
from .texture_regions import TEXTURE_REGIONS, RegionOutsideImageError, make_texture_region
from .texture_scales import SCALES_MM, UnmeasurableTextureError

__all__ = [
    "SCALES_MM",
    "TEXTURE_FAMILIES",
    "TEXTURE_REGIONS",
    "FractalSignature",
    "OrientationSignature",
    "RegionOutsideImageError",
    "UnmeasurableTextureError",
    "fractal_signature",
    "hurst_orientation_transform",
    "local_binary_patterns",
    "make_texture_region",
    "measure_texture_features",
    "mirror_texture_features",
    "spectral_slope",
    "variance_orientation_transform",
]
