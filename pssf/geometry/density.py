"""Densities that vary within a material, relative to its own: what an engine integrates instead of a length."""

import math
import reprlib
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from ..core.compiled import kernel

Vectors = tuple[tuple[float, float, float], ...]


@runtime_checkable
class Density(Protocol):
    """Relative density as a function of the place; 1 is the material's own."""

    def integrate(self, starts_mm: Array, ends_mm: Array) -> Array:
        """(n,)  integral along straight segments, mm

        starts_mm, ends_mm  (n, 3)  knee frame
        """
        ...


def integrated(density: Density, starts_mm: Array, ends_mm: Array) -> Array:
    """(n,)  integrals of a density along straight segments, mm, held to what a Density promises

    starts_mm, ends_mm  (n, 3)  knee frame
    raises              InputError for anything but one finite number a segment
    """
    integrals = density.integrate(starts_mm, ends_mm)
    allowed = f"allowed: ({len(starts_mm)},) finite numbers, mm, one a segment"
    what = f"{type(density).__name__}.integrate gave"
    try:
        values = np.asarray(integrals)
    except ValueError:  # rows of unequal length
        values = np.empty(0, object)
    if values.dtype.kind not in "fiu" or values.shape != (len(starts_mm),):
        kind = f"{values.dtype} of shape {values.shape}" if values.ndim else reprlib.repr(integrals)
        raise InputError(f"{what} {kind}; {allowed}")
    finite = np.isfinite(values)
    if not finite.all():
        first = int(np.argmin(finite))
        bad = len(values) - int(finite.sum())
        raise InputError(
            f"{what} {values[first]} for {bad} segments, first from {_place(starts_mm[first])} to "
            f"{_place(ends_mm[first])} mm; {allowed}"
        )
    return values.astype(np.float64, copy=False)


def _place(point_mm: Array) -> str:
    return "(" + ", ".join(f"{part:.4g}" for part in point_mm) + ")"


@dataclass(frozen=True, kw_only=True)
class Moved:
    """A density that has moved with the solid that it is of.

    density  as it was
    by_mm    (x, y, z)  by which it has moved
    """

    density: Density
    by_mm: tuple[float, float, float]

    def integrate(self, starts_mm: Array, ends_mm: Array) -> Array:
        """(n,)  integral along straight segments, mm

        starts_mm, ends_mm  (n, 3)  where the density is now
        """
        by = np.array(self.by_mm)
        return self.density.integrate(starts_mm - by, ends_mm - by)


@dataclass(frozen=True, kw_only=True)
class PlaneWaves:
    """mean + sum over k of amplitude[k] cos(wave[k] . place + phase[k]), whose integrals are closed forms.

    waves_per_mm  radians per mm, each with three components
    raises        InputError if the parts differ in number or are not finite
    """

    mean: float = 1.0
    amplitudes: tuple[float, ...] = ()
    waves_per_mm: Vectors = ()
    phases: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        counts = len(self.amplitudes), len(self.waves_per_mm), len(self.phases)
        if len(set(counts)) > 1:
            raise InputError(f"plane waves: {counts} amplitudes, waves and phases; allowed: as many of each")
        for wave in self.waves_per_mm:
            if len(wave) != 3:
                raise InputError(f"plane waves: a wave of {len(wave)} parts, {wave!r}; allowed: three, in radians/mm")
        numbers = (self.mean, *self.amplitudes, *self.phases, *(part for wave in self.waves_per_mm for part in wave))
        for number in numbers:
            if not math.isfinite(number):
                raise InputError(f"plane waves: {number!r} is not finite; allowed: finite numbers")

    def integrate(self, starts_mm: Array, ends_mm: Array) -> Array:
        """(n,)  integral along straight segments, mm

        starts_mm, ends_mm  (n, 3)  knee frame
        """
        waves = np.array(self.waves_per_mm, float).reshape(-1, 3)
        out = np.empty(len(starts_mm))
        _sum_waves(starts_mm, ends_mm, self.mean, np.array(self.amplitudes, float), waves, np.array(self.phases), out)
        return out


@kernel()
def _sum_waves(
    starts: Array, ends: Array, mean: float, amplitudes: Array, waves: Array, phases: NDArray[np.float64], out: Array
) -> None:
    for k in range(len(starts)):
        x, y, z = ends[k, 0] - starts[k, 0], ends[k, 1] - starts[k, 1], ends[k, 2] - starts[k, 2]
        total = mean
        for n in range(len(amplitudes)):
            u, v, w = waves[n]
            # Mean of a cosine over a span: its value in the middle times sinc of half the change of phase. Unlike the
            # difference of two sines over k.d it stays exact when a wave runs across the ray.
            half = (u * x + v * y + w * z) / 2
            middle = u * starts[k, 0] + v * starts[k, 1] + w * starts[k, 2] + half + phases[n]
            sinc = math.sin(half) / half if abs(half) > 1e-4 else 1.0 - half * half / 6
            total += amplitudes[n] * math.cos(middle) * sinc
        out[k] = total * math.sqrt(x * x + y * y + z * z)
