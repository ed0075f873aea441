"""lattice: a seed -> the struts of a knee, a periodic block of relative bone content made by FFT."""

from functools import lru_cache
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..data.spongy import Lattice

Block = NDArray[np.uint8]
# Beyond this the exponential leaves nothing of 255, and it overflows beyond 88.
_EMPTY = np.float32(80.0)
# Planes at a time: nothing as large as the block is held in float32, and what is stays in the cache.
_PART = 8
# No person is farther off than so many deviations.
_MOST_SD = 2.0
_MAKING = Lock()
_LAST: dict[tuple[int, Lattice], tuple[Block, float]] = {}


def lattice(seed: int, table: Lattice) -> tuple[Block, float]:
    """(nx + 1, nz + 1, ny)  bone content of the voxels, 0 none and 255 solid, periodic; and what makes its mean 1

    A Gaussian field with the power spectrum of `data/trabeculae.toml`, cut off softly: bone where it is high, next to
    none elsewhere. y comes last, so that a ray along it reads what lies side by side; in x and in z the first voxels
    stand once more after the last, so that what lies beside a voxel is always as far on. Kept until another seed comes.
    """
    with _MAKING:  # a second thread waits for the first, instead of making the same again
        if (seed, table) not in _LAST:
            _LAST.clear()
            _LAST[seed, table] = _made(seed, table)
        return _LAST[seed, table]


def personal_factor(spread: float, rng: np.random.Generator) -> float:
    """By what a person differs from the median one: lognormal, `spread` the deviation of its logarithm."""
    return float(np.exp(spread * np.clip(rng.standard_normal(), -_MOST_SD, _MOST_SD)))


def _made(seed: int, table: Lattice) -> tuple[Block, float]:
    nx, nz, ny = table.voxels
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    usual, spread = table.patches
    share = usual * personal_factor(spread, rng)
    struts, patches = _powers(table)
    amplitude = np.sqrt((1 - share) * struts + share * patches, dtype=np.float32)
    waves = rng.standard_normal((nx, nz, 2 * amplitude.shape[2]), np.float32).view(np.complex64)
    # Power is the same at f and -f; negative frequencies come second and in falling order.
    across, up = (np.minimum(np.arange(n), n - np.arange(n)) for n in (nx, nz))
    for i, wave in enumerate(waves):
        wave *= amplitude[across[i], up]
    waves = fft.ifft2(waves, axes=(0, 1), norm="forward", workers=2, overwrite_x=True)
    block = np.empty((nx + 1, nz + 1, ny), np.uint8)
    for i in range(0, nx, _PART):
        field = fft.irfft(waves[i : i + _PART], ny, axis=2, norm="forward", workers=2)
        field -= np.float32(table.cut)
        field *= np.float32(-1 / table.softness)
        np.minimum(field, _EMPTY, out=field)
        np.exp(field, out=field)
        field += 1
        block[i : i + _PART, :nz] = np.rint(np.divide(255, field, out=field), out=field)
    block[nx], block[:, nz] = block[0], block[:, 0]
    block.setflags(write=False)
    return block, 1 / float(block[:nx, :nz].mean())


@lru_cache(maxsize=2)
def _powers(table: Lattice) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(nx / 2 + 1, nz / 2 + 1, waves along y) each  of fields of struts and of patches, with variance 1;
    frequencies not negative
    """
    steps = (np.fft.rfftfreq(n, d).astype(np.float32) for n, d in zip(table.voxels, table.voxel_mm, strict=True))
    fx, fz, fy = np.meshgrid(*steps, indexing="ij", sparse=True)
    fy = fy[..., : table.waves_y] * np.float32(table.stretch_y)
    across, along = fx**2 + fy**2, np.float32(table.length_per_mm)
    total = across + fz**2
    up = np.exp(-(fz**2) / (2 * (along + table.spread * np.sqrt(across)) ** 2))
    level = np.exp(-across / (2 * (along + table.spread * fz) ** 2))
    power = (total + np.float32(table.low_per_mm) ** 2) ** np.float32(table.rise / 2)
    power /= 1 + (total / np.float32(table.high_per_mm) ** 2) ** np.float32(table.steep / 2)
    power *= table.upright * up + table.level * level + table.any
    # What is dense and what is bare: as long along y as across, and taller.
    tall, deep = np.float32(table.patch_tall), np.float32(table.stretch_y)
    patches = np.exp(-(fx**2 + (fz * tall) ** 2 + (fy / deep) ** 2) / (2 * table.patch_per_mm**2))
    return _of_variance_1(power, table), _of_variance_1(patches, table)


def _of_variance_1(power: NDArray[np.float32], table: Lattice) -> NDArray[np.float32]:
    """Powers (nx / 2 + 1, nz / 2 + 1, waves along y), changed in place to those of a field of variance 1."""
    power[0, 0, 0] = 0
    # Each of the waves stands for two or four of frequencies of either sign. Those along y are the half that a real
    # transform holds; it reads the plane fy = 0 as if half of that were the mirror image of the other half.
    of = [np.where((np.arange(n // 2 + 1) == 0) | (np.arange(n // 2 + 1) == n // 2), 1, 2) for n in table.voxels[:2]]
    held = np.einsum("i,j,ijk->k", *of, power, dtype=np.float64) * np.where(np.arange(power.shape[2]), 4, 2)
    power /= np.float32(held.sum())
    power[..., 0] *= 2
    return power
