"""Command that calibrates a detector from its own images."""

from pathlib import Path
from typing import Annotated

import typer

from .shared_options import ProtocolName


def calibrate(
    *,
    more_flats: Annotated[
        list[Path] | None, typer.Argument(metavar="[FLATS]", help="More flat fields, as a shell expands flat_*.tif.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Detector file (.toml); the other files are written beside it.")],
    dark: Annotated[str, typer.Option(help="Images without exposure, separated by commas.")] = "",
    flats: Annotated[
        str, typer.Option(help="Flat fields, separated by commas, or a pattern such as 'flat_*.tif'; sorted by number.")
    ] = "",
    mas: Annotated[str, typer.Option(help="mAs of each flat field, separated by commas.")] = "",
    edge: Annotated[Path | None, typer.Option(help="Image of a slanted edge of an opaque plate.")] = None,
    wedge: Annotated[str, typer.Option(help="Images of a step wedge at different tube voltages.")] = "",
    wedge_kv: Annotated[
        str, typer.Option(help="Tube voltages of the wedge images in kV. Default: last number in each file name.")
    ] = "",
    steps: Annotated[
        Path | None,
        typer.Option(help="CSV file of the steps: thickness_mm, and their regions top, bottom, left, right in pixels."),
    ] = None,
    material: Annotated[str, typer.Option(help="Material of the wedge.")] = "Al@2.70",
    radiographs: Annotated[
        str, typer.Option(help="Linear radiographs of patients instead of flat fields, or a pattern.")
    ] = "",
    pixel: Annotated[
        float | None, typer.Option(help="Pixel pitch in mm. Default: that of DICOM files, or of the protocol.")
    ] = None,
    protocol: ProtocolName = "reference",
) -> None:
    """Measure a detector and its beam from flat fields, an edge and a step wedge, and write a detector file.

    Any of the images can be missing. Without a phantom, radiographs of patients determine the noise. The protocol gives
    the distance of the source, the nominal tube voltage and filtration of the flat fields, and the detector from which
    values are taken that the images do not determine.
    """
    from ..calibration import calibrate_detector, read_calibration_images, write_calibration
    from ..core.checks import InputError
    from ..model.protocol import load_protocol

    if out.suffix != ".toml":
        raise InputError(f"out must be a .toml file, got {out}")
    technique = load_protocol(protocol)
    images = read_calibration_images(
        darks=_expand(dark),
        radiographs=_expand(radiographs),
        flats=[*_expand(flats), *(more_flats or [])],
        flat_mas=_parse_numbers("mas", mas),
        edge=edge,
        wedges=_expand(wedge),
        wedge_kv=_parse_numbers("wedge-kv", wedge_kv),
        steps=steps,
        step_material=material,
        pixel_mm=pixel,
        default_pixel_mm=technique.pixel_mm,
    )
    result = calibrate_detector(images, technique, name=out.stem)
    print(f"pixel pitch {images.pixel_mm:g} mm, source distance {technique.sdd_mm:g} mm")
    for name, one in result.estimates.items():
        interval = f"{one.low:.5g} to {one.high:.5g}" if one.source == "measured" else f"held: {one.note}"
        print(f"{name:24} {one.value:<12.6g} {interval}")
    for path in write_calibration(result, out):
        print(path)


def _expand(names: str) -> list[Path]:
    """Split names at commas, and expand patterns to the files that match."""
    from glob import glob

    from ..core.checks import InputError

    paths: list[Path] = []
    for name in filter(None, (part.strip() for part in names.split(","))):
        matches = sorted(glob(name)) if any(sign in name for sign in "*?[") else [name]
        if not matches:
            raise InputError(f"no file matches {name}")
        paths += map(Path, matches)
    return paths


def _parse_numbers(name: str, text: str) -> list[float]:
    """Parse numbers that are separated by commas."""
    from ..core.checks import InputError

    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise InputError(f"{name} must be numbers separated by commas, got {text!r}") from None
