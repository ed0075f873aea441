"""Recognise image files by suffix or first bytes, and skip hidden files and lock files."""

from pathlib import Path

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
# Suffixes that archives and viewers give to DICOM files. DICOM files without them are recognised by their first bytes.
DICOM_SUFFIXES = (".dcm", ".dicom", ".dic", ".dc3", ".ima")
SUFFIXES = (*PICTURE_SUFFIXES, *DICOM_SUFFIXES)
# Hidden files, resource forks (._x), folders that macOS adds to archives, and locks of office programs (~$x).
_HIDDEN_PREFIXES = (".", "__MACOSX", "~$")
# Name of the index file of a DICOM medium, which is a DICOM file without an image.
_DICOM_INDEX_NAME = "DICOMDIR"
# DICOM PS3.10, 7.1: a preamble of 128 bytes is followed by these four characters.
_MAGIC = b"DICM"
_PREAMBLE = 128  # length of the preamble, in bytes


def is_dicom(path: Path) -> bool:
    """Return whether a file is DICOM, by its suffix, or by its first bytes if its suffix is unknown.

    Parameters
    ----------
    path : Path
        File to check.

    Returns
    -------
    bool
        True for DICOM. False for DICOMDIR, the index file of a DICOM medium.

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
    """Return whether a file is an image, by its suffix or as DICOM by its first bytes.

    Parameters
    ----------
    path : Path
        File to check.

    Returns
    -------
    bool
        True for PNG, JPEG, TIFF and DICOM.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    return path.suffix.lower() in PICTURE_SUFFIXES or is_dicom(path)


def list_files(folder: Path) -> list[Path]:
    """List the files of a folder, without hidden files, resource forks and lock files.

    Parameters
    ----------
    folder : Path
        Folder to list. Subfolders are not searched.

    Returns
    -------
    list of Path
        Files sorted by name; empty if the folder does not exist.
    """
    return sorted(path for path in folder.glob("*") if is_visible(path) and path.is_file())


def is_visible(path: Path) -> bool:
    """Return whether a file or folder is neither hidden nor a resource fork nor a lock file.

    Parameters
    ----------
    path : Path
        File or folder, of which only the name is used.

    Returns
    -------
    bool
        True for files and folders that a user created.
    """
    return not path.name.startswith(_HIDDEN_PREFIXES)
