"""Files of a folder that a user sees, and kinds of image files by suffix or first bytes."""

from pathlib import Path

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
# As archives and viewers name them; files of any other name are DICOM by their first bytes.
DICOMS = (".dcm", ".dicom", ".dic", ".dc3", ".ima")
SUFFIXES = (*PICTURES, *DICOMS)
# Hidden files and folders, resource forks (._x), what archives of a Mac hold besides, locks of office programs (~$x).
_UNSEEN = (".", "__MACOSX", "~$")
# An index of a medium, in DICOM's own format.
_INDEX = "DICOMDIR"
_MAGIC, _PREAMBLE = b"DICM", 128


def is_dicom(path: Path) -> bool:
    """Tell whether a file is DICOM: by its suffix, or by its first bytes where the suffix is of no image.

    raises  OSError for a file that cannot be read
    """
    suffix = path.suffix.lower()
    if suffix in DICOMS:
        return True
    if suffix in PICTURES or path.name.upper() == _INDEX or not path.is_file():
        return False
    with open(path, "rb") as handle:
        return handle.read(_PREAMBLE + len(_MAGIC))[_PREAMBLE:] == _MAGIC


def is_image(path: Path) -> bool:
    """Tell whether a file is read as an image: by its suffix, or as DICOM by its first bytes."""
    return path.suffix.lower() in PICTURES or is_dicom(path)


def files_of(folder: Path) -> list[Path]:
    """List the files of a folder by name, without hidden files, resource forks and locks."""
    return sorted(path for path in folder.glob("*") if is_visible(path) and path.is_file())


def is_visible(path: Path) -> bool:
    """Tell whether a file or folder is a user's own: no hidden one, resource fork or lock."""
    return not path.name.startswith(_UNSEEN)
