"""The command that measures radiomic features of own images."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from .options import Out, Processes


def features(
    folder: Annotated[Path, typer.Argument(help="Folder of images: PNG, JPEG, TIFF or DICOM of 8 to 16 bit.")],
    *,
    out: Out,
    workers: Processes,
    pixel_mm: Annotated[float, typer.Option(help="Side of a pixel, mm; 0: as each file says.")] = 0.0,
    bins: Annotated[int, typer.Option(help="Grey-level bins of textures.")] = 64,
    families: Annotated[str, typer.Option(help="Families of features, with commas; all if none is named.")] = "",
    backend: Annotated[
        str, typer.Option(help="What measures features: pyradiomics or mirp; the first that is installed if none.")
    ] = "",
) -> None:
    """Radiomic features of own images and masks, without a model, as features.csv.

    The mask of X.png is X_mask.png beside it, or X (any suffix) in a folder masks in the folder or beside it. Pixels
    that are not zero are measured; an image without a mask is measured whole.
    """
    from ..core.checks import InputError
    from ..core.execution import Execution
    from ..core.progress import bar
    from ..io import results
    from ..study import require_extra

    require_extra()
    from ..radiomics.families import FAMILIES
    from ..study.feature_folder import WHOLE, measure_folder

    table = measure_folder(
        folder,
        Execution(workers=workers, bar=bar),
        pixel_mm=pixel_mm or None,
        bins=bins,
        families=tuple(families.split(",")) if families else FAMILIES,
        backend=backend or None,
    )
    for row in table.loc[table["status"] != "measured", ["file", "status"]].to_dict("records"):
        print(f"pssf: {row['file']}: {row['status']}", file=sys.stderr)
    measured = table[table["status"] == "measured"]
    if measured.empty:
        raise InputError(f"folder {folder}: no image could be measured; the lines above say why")
    whole = int((measured["mask"] == WHOLE).sum())
    if whole:
        print(f"pssf: {whole} of {len(measured)} rows are of whole images; no mask was found for them", file=sys.stderr)
    path = out / "features.csv"
    results.save_table(path, table)
    print(f"table     {path}, {len(measured)} of {len(table)} rows measured")
