"""Maps of path lengths, stored in bands of rows without the empty columns beside the object.

For a large detector, the path length maps use most of the memory of a simulation, and most of their pixels show air.
"""

from mmap import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .projected_surface import BAND_ROWS


class SparseMap:
    """Path length map of shape (rows, cols), in mm, that is written and read in bands of rows.

    Reading returns the same numbers as a full array; columns that are not stored are zero.

    Parameters
    ----------
    shape : tuple of int
        Number of rows and columns.
    dtype : str, default "float32"
        Floating-point type of the path lengths.
    """

    def __init__(self, shape: tuple[int, int], dtype: str = "float32") -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)
        self._row_bands: dict[int, tuple[int, NDArray[Any]]] = {}

    def __setitem__(self, rows: slice, values: NDArray[Any]) -> None:
        """Write a band of at most `BAND_ROWS` rows that starts at a multiple of `BAND_ROWS`."""
        used = np.flatnonzero(values.any(axis=0))
        if len(used):
            left, right = int(used[0]), int(used[-1]) + 1
            # Each band has its own memory map, because the operating system frees it as soon as the map is deleted.
            # Heap memory would remain allocated to the process.
            piece = np.frombuffer(mmap(-1, len(values) * (right - left) * self.dtype.itemsize), self.dtype)
            piece = piece.reshape(len(values), right - left)
            piece[:] = values[:, left:right]
            self._row_bands[rows.start] = (left, piece)
        else:
            self._row_bands.pop(rows.start, None)

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """Read a range of rows as a new array (rows, cols)."""
        start, stop, _ = rows.indices(self.shape[0])
        out = np.zeros((stop - start, self.shape[1]), self.dtype)
        for first in range(start // BAND_ROWS * BAND_ROWS, stop, BAND_ROWS):
            if first in self._row_bands:
                left, values = self._row_bands[first]
                top, bottom = max(first, start), min(first + len(values), stop)
                out[top - start : bottom - start, left : left + values.shape[1]] = values[top - first : bottom - first]
        return out

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return self[0 : self.shape[0]].astype(dtype or self.dtype, copy=False)

    def max(self) -> float:
        """Return the longest path length in the map.

        Returns
        -------
        float
            Path length in mm.
        """
        return float(np.max(self._extremes(np.max)))

    def min(self) -> float:
        """Return the shortest path length in the map.

        Returns
        -------
        float
            Path length in mm.
        """
        return float(np.min(self._extremes(np.min)))

    def _extremes(self, of: Any) -> list[Any]:
        """Return the minimum or maximum of every stored band, and 0 if some pixels are not stored."""
        values = [of(part) for _, part in self._row_bands.values()]
        held = sum(part.size for _, part in self._row_bands.values())
        return values if held == self.shape[0] * self.shape[1] else [*values, self.dtype.type(0)]
