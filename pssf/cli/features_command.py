"""Command `features`: measure radiomic features of user images."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from .shared_options import Families, Out, Processes


def features(
    folder: Annotated[
        Path, typer.Argument(help="Folder of PNG, JPEG, TIFF or DICOM images with 8 to 16 bits per pixel.")
    ],
    *,
    out: Out,
    workers: Processes,
    pixel_mm: Annotated[float, typer.Option(help="Pixel size in mm; 0 reads it from each file.")] = 0.0,
    bins: Annotated[int, typer.Option(help="Number of grey-level bins for texture features.")] = 64,
    families: Families = "",
    backend: Annotated[
        str,
        typer.Option(help="Radiomics library: pyradiomics or mirp; default: pyradiomics if installed, else mirp."),
    ] = "",
) -> None:
    """Measure radiomic features of your own images and masks, without a model, and write features.csv.

    The mask of X.png is X_mask.png in the same folder, or X with any suffix in a folder named masks. This folder may be
    inside FOLDER or next to it. Pixels with a non-zero mask value are measured. In an image without a mask, all pixels
    are measured.
    """
    from ..core.checks import InputError
    from ..core.processes.execution import Execution
    from ..core.progress_display import show_progress_bar
    from ..io import study_results
    from ..study import require_extra

    require_extra()
    from ..radiomics.features.feature_families import FAMILIES
    from ..study.prediction.feature_folder import WHOLE_IMAGE, measure_folder

    table = measure_folder(
        folder,
        Execution(workers=workers, progress_bar=show_progress_bar),
        pixel_mm=pixel_mm or None,
        bins=bins,
        families=tuple(families.split(",")) if families else FAMILIES,
        backend=backend or None,
    )
    for row in table.loc[table["status"] != "measured", ["file", "status"]].to_dict("records"):
        print(f"pssf: {row['file']}: {row['status']}", file=sys.stderr)
    measured = table[table["status"] == "measured"]
    if measured.empty:
        raise InputError(
            f"folder {folder} must contain an image that can be measured, got none: the lines above give the reasons"
        )
    whole = int((measured["mask"] == WHOLE_IMAGE).sum())
    if whole:
        print(
            f"pssf: {whole} of {len(measured)} images have no mask, so all their pixels are measured; to measure "
            "a region, add a mask X_mask.png",
            file=sys.stderr,
        )
    path = out / "features.csv"
    study_results.save_table(path, table)
    print(f"table     {path}, {len(measured)} of {len(table)} rows measured")
