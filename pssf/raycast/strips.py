"""Maps of path lengths held in strips of rows, each without the columns beside the object.

Of a large detector the maps of all materials are most of what a radiograph holds, and most of them is air.
"""

from mmap import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .sheets import BAND_ROWS


class Strips:
    """A (rows, cols) map in mm that is written and read by rows; the same numbers as of an array, zeros included.

    shape  (rows, cols)
    dtype  of its numbers
    """

    def __init__(self, shape: tuple[int, int], dtype: str = "float32") -> None:
        self.shape, self.dtype = shape, np.dtype(dtype)
        self._strips: dict[int, tuple[int, NDArray[Any]]] = {}

    def __setitem__(self, rows: slice, values: NDArray[Any]) -> None:
        """Write a band: rows that begin at a whole number of bands, and no more than one."""
        used = np.flatnonzero(values.any(axis=0))
        if len(used):
            left, right = int(used[0]), int(used[-1]) + 1
            # Memory of its own, which the system has back at once: the heap would keep what many small pieces left.
            piece = np.frombuffer(mmap(-1, len(values) * (right - left) * self.dtype.itemsize), self.dtype)
            piece = piece.reshape(len(values), right - left)
            piece[:] = values[:, left:right]
            self._strips[rows.start] = (left, piece)
        else:
            self._strips.pop(rows.start, None)

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """(rows asked for, cols)  as an array of its own"""
        start, stop, _ = rows.indices(self.shape[0])
        out = np.zeros((stop - start, self.shape[1]), self.dtype)
        for first in range(start // BAND_ROWS * BAND_ROWS, stop, BAND_ROWS):
            if first in self._strips:
                left, values = self._strips[first]
                top, bottom = max(first, start), min(first + len(values), stop)
                out[top - start : bottom - start, left : left + values.shape[1]] = values[top - first : bottom - first]
        return out

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return self[0 : self.shape[0]].astype(dtype or self.dtype, copy=False)

    def max(self) -> float:
        """Longest path, mm."""
        return float(np.max(self._extremes(np.max)))

    def min(self) -> float:
        """Shortest path, mm."""
        return float(np.min(self._extremes(np.min)))

    def _extremes(self, of: Any) -> list[Any]:
        values = [of(part) for _, part in self._strips.values()]
        held = sum(part.size for _, part in self._strips.values())
        return values if held == self.shape[0] * self.shape[1] else [*values, self.dtype.type(0)]
