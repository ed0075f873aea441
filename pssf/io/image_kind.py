"""Identification of image files by suffix or first bytes, without hidden files and lock files."""

from pathlib import Path

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
# Usual suffixes of DICOM files. DICOM files with other suffixes are identified by their first bytes.
DICOM_SUFFIXES = (".dcm", ".dicom", ".dic", ".dc3", ".ima")
SUFFIXES = (*PICTURE_SUFFIXES, *DICOM_SUFFIXES)
# Name prefixes of hidden files and resource forks (._x), of folders that macOS adds to archives, and of lock files of
# office programs (~$x).
_HIDDEN_PREFIXES = (".", "__MACOSX", "~$")
# Name of the index file of a DICOM medium, which is a DICOM file without an image.
_DICOM_INDEX_NAME = "DICOMDIR"
# Four characters that follow the preamble of a DICOM file (DICOM PS3.10, 7.1).
_MAGIC = b"DICM"
_PREAMBLE = 128  # length of the preamble of a DICOM file, in bytes (DICOM PS3.10, 7.1)


def is_dicom(path: Path) -> bool:
    """Report whether a file is a DICOM file; its first bytes are read only if its suffix is unknown.

    Parameters
    ----------
    path : Path
        File to check.

    Returns
    -------
    bool
        True for a DICOM file, but False for DICOMDIR, the index file of a DICOM medium.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix in DICOM_SUFFIXES:
        return True
    if suffix in PICTURE_SUFFIXES or path.name.upper() == _DICOM_INDEX_NAME or not path.is_file():
        return False
    with open(path, "rb") as handle:
        return handle.read(_PREAMBLE + len(_MAGIC))[_PREAMBLE:] == _MAGIC


def is_image(path: Path) -> bool:
    """Report whether a file is an image; the first bytes are read only to identify DICOM files.

    Parameters
    ----------
    path : Path
        File to check.

    Returns
    -------
    bool
        True for PNG, JPEG, TIFF and DICOM files.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    return path.suffix.lower() in PICTURE_SUFFIXES or is_dicom(path)


def list_files(folder: Path) -> list[Path]:
    """List the files in a folder, except for hidden files, resource forks and lock files.

    Parameters
    ----------
    folder : Path
        Folder to list. Subfolders are not searched.

    Returns
    -------
    list of Path
        Files, sorted by name; empty if the folder does not exist.
    """
    return sorted(path for path in folder.glob("*") if is_visible(path) and path.is_file())


def is_visible(path: Path) -> bool:
    """Report whether a file or folder is neither hidden nor a resource fork nor a lock file.

    Parameters
    ----------
    path : Path
        Path of the file or folder. Only the name is used.

    Returns
    -------
    bool
        False for a hidden file or folder, a resource fork or a lock file.
    """
    return not path.name.startswith(_HIDDEN_PREFIXES)
