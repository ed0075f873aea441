"""Relative densities that vary within a material, and their integrals along rays."""

import math
import reprlib
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from ..core.numba_kernel import kernel

Vectors = tuple[tuple[float, float, float], ...]


@runtime_checkable
class Density(Protocol):
    """Relative density as a function of position; 1 is the tabulated density of the material.

    Any object with an `integrate` method can serve as the density of a `Surface`.
    """

    def integrate(self, starts_mm: Array, ends_mm: Array) -> Array:
        """Integrate the density along straight segments.

        Parameters
        ----------
        starts_mm : (n, 3) float64 array
            Start points in the knee frame, in mm.
        ends_mm : (n, 3) float64 array
            End points in the knee frame, in mm.

        Returns
        -------
        (n,) float64 array
            Integral along each segment, in mm.
        """
        ...


def integrate_along_segments(density: Density, starts_mm: Array, ends_mm: Array) -> Array:
    """Integrate a density along straight segments and check that the result is valid.

    Parameters
    ----------
    density : Density
        Relative density to integrate.
    starts_mm : (n, 3) float64 array
        Start points in the knee frame, in mm.
    ends_mm : (n, 3) float64 array
        End points in the knee frame, in mm.

    Returns
    -------
    (n,) float64 array
        Integral along each segment, in mm.

    Raises
    ------
    InputError
        If the density function does not return one finite number per segment.
    """
    integrals = density.integrate(starts_mm, ends_mm)
    allowed = f"must return ({len(starts_mm)},) finite numbers in mm, one for each segment"
    what = f"{type(density).__name__}.integrate"
    try:
        values = np.asarray(integrals)
    except ValueError:  # NumPy cannot convert nested lists of unequal lengths to an array.
        values = np.empty(0, object)
    if values.dtype.kind not in "fiu" or values.shape != (len(starts_mm),):
        kind = f"{values.dtype} of shape {values.shape}" if values.ndim else reprlib.repr(integrals)
        raise InputError(f"{what} {allowed}, got {kind}")
    finite = np.isfinite(values)
    if not finite.all():
        first = int(np.argmin(finite))
        bad = len(values) - int(finite.sum())
        raise InputError(
            f"{what} {allowed}, got {values[first]} for {bad} segments, first from {_format_point(starts_mm[first])} "
            f"to {_format_point(ends_mm[first])} mm"
        )
    return values.astype(np.float64, copy=False)


def _format_point(point_mm: Array) -> str:
    """Format a point (3,) with four significant digits."""
    return "(" + ", ".join(f"{part:.4g}" for part in point_mm) + ")"


@dataclass(frozen=True, kw_only=True)
class TranslatedDensity:
    """Relative density that is translated together with the solid to which it belongs.

    Parameters
    ----------
    density : Density
        Density before the translation.
    offset_mm : tuple of float
        Translation (x, y, z), in mm.
    """

    density: Density
    offset_mm: tuple[float, float, float]

    def integrate(self, starts_mm: Array, ends_mm: Array) -> Array:
        """Integrate the translated density along straight segments.

        Parameters
        ----------
        starts_mm : (n, 3) float64 array
            Start points in the frame after the translation, in mm.
        ends_mm : (n, 3) float64 array
            End points in the frame after the translation, in mm.

        Returns
        -------
        (n,) float64 array
            Integral along each segment, in mm.
        """
        by = np.array(self.offset_mm)
        return self.density.integrate(starts_mm - by, ends_mm - by)


@dataclass(frozen=True, kw_only=True)
class PlaneWaves:
    """Relative density as a sum of plane waves, which can be integrated along a line analytically.

    The density at a position p is ``mean + sum over k of amplitudes[k] * cos(waves_per_mm[k] . p + phases[k])``.

    Parameters
    ----------
    mean : float, default 1.0
        Mean relative density, dimensionless.
    amplitudes : tuple of float, optional
        Amplitude of each wave, dimensionless.
    waves_per_mm : tuple of tuple of float, optional
        Wave vector (x, y, z) of each wave, in radians per mm.
    phases : tuple of float, optional
        Phase of each wave, in radians.

    Raises
    ------
    InputError
        If the numbers of amplitudes, wave vectors and phases differ, or if a value is not finite.
    """

    mean: float = 1.0
    amplitudes: tuple[float, ...] = ()
    waves_per_mm: Vectors = ()
    phases: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        counts = len(self.amplitudes), len(self.waves_per_mm), len(self.phases)
        if len(set(counts)) > 1:
            raise InputError(f"plane waves: amplitudes, waves and phases must have equal lengths, got {counts}")
        for wave in self.waves_per_mm:
            if len(wave) != 3:
                raise InputError(
                    f"plane waves: a wave must have three components in radians/mm, got {len(wave)}: {wave!r}"
                )
        numbers = (self.mean, *self.amplitudes, *self.phases, *(part for wave in self.waves_per_mm for part in wave))
        for number in numbers:
            if not math.isfinite(number):
                raise InputError(f"plane waves: all numbers must be finite, got {number!r}")

    def integrate(self, starts_mm: Array, ends_mm: Array) -> Array:
        """Integrate the density along straight segments.

        Parameters
        ----------
        starts_mm : (n, 3) float64 array
            Start points in the knee frame, in mm.
        ends_mm : (n, 3) float64 array
            End points in the knee frame, in mm.

        Returns
        -------
        (n,) float64 array
            Integral along each segment, in mm.
        """
        waves = np.array(self.waves_per_mm, float).reshape(-1, 3)
        out = np.empty(len(starts_mm))
        _sum_waves(starts_mm, ends_mm, self.mean, np.array(self.amplitudes, float), waves, np.array(self.phases), out)
        return out


@kernel()
def _sum_waves(
    starts: Array, ends: Array, mean: float, amplitudes: Array, waves: Array, phases: NDArray[np.float64], out: Array
) -> None:
    """Write the density integral along each segment, in mm, to `out` (n,)."""
    for k in range(len(starts)):
        x, y, z = ends[k, 0] - starts[k, 0], ends[k, 1] - starts[k, 1], ends[k, 2] - starts[k, 2]
        total = mean
        for n in range(len(amplitudes)):
            u, v, w = waves[n]
            # The mean of a cosine along a segment is the cosine at the segment centre, multiplied by the sinc function
            # of half the phase change. A difference of sines divided by the phase change would lose precision for
            # waves perpendicular to the ray.
            half = (u * x + v * y + w * z) / 2
            middle = u * starts[k, 0] + v * starts[k, 1] + w * starts[k, 2] + half + phases[n]
            sinc = math.sin(half) / half if abs(half) > 1e-4 else 1.0 - half * half / 6
            total += amplitudes[n] * math.cos(middle) * sinc
        out[k] = total * math.sqrt(x * x + y * y + z * z)
