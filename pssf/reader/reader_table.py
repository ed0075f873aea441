"""Mean shape and thresholds of the reader, in the file ``reader.json`` beside its networks."""

from pathlib import Path

import msgspec

from ..data.user_files import read_json

# Networks that come with the package.
PACKAGE_FOLDER = Path(__file__).resolve().parents[1] / "data" / "reader"
TABLE_FILE = "reader.json"


class ReaderTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Mean shape and thresholds, which training determines on simulated radiographs.

    Attributes
    ----------
    min_score : float
        Least score of a knee, 0 to 1; nothing is reported for lower scores.
    min_side_confidence : float
        Least probability of the side of a knee that is not refused, 0.5 to 1.
    min_confidence : float
        Least median confidence of the landmarks of a knee that is not refused.
    max_shape_residual : float
        Largest shape residual of a knee that is not refused, as a fraction of the plateau width.
    mean_shape : tuple of (float, float)
        Mean row and column of the sixteen landmarks in the frame of the knee, as fractions of the plateau width.
    """

    min_score: float
    min_side_confidence: float
    min_confidence: float
    max_shape_residual: float
    mean_shape: tuple[tuple[float, float], ...]


def load_reader_table(folder: Path) -> ReaderTable:
    """Load mean shape and thresholds.

    Parameters
    ----------
    folder : Path
        Folder with the output of ``pssf train-reader``.

    Returns
    -------
    ReaderTable
        Mean shape and thresholds.

    Raises
    ------
    InputError
        The file is missing or damaged.
    """
    return read_json(folder / TABLE_FILE, ReaderTable)
