"""Ablation of the reader: train the landmark network in variants, and compare them on simulations and on patients.

Run ``python -m tools.reader_ablation OUT --data DATA --films FILMS --compare ANNOTATIONS`` in the folder ``tests``.
DATA is a data set of ``pssf dataset``, FILMS a folder of radiographs, and ANNOTATIONS their table of landmarks (see
``pssf landmarks --compare``). Knees are found by the locator of ``--networks``, or of the package. The command writes
OUT/reader_ablation.csv. A repeated run continues where it stopped: variants with a result are not trained again.
Several processes may train different variants (``--variant``) with the same OUT; a last run without this option writes
the table. It needs the extra ``train``.
"""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import torch
import typer

from pssf.core.label_names import CONTOUR_LANDMARKS
from pssf.io.atomic_write import make_folder
from pssf.io.cohort_records import write_csv, write_json
from pssf.io.patients.landmark_annotations import LandmarkAnnotation, read_landmark_annotations
from pssf.io.run_record import start_run_record
from pssf.reader.film_reading import read
from pssf.reader.knee_reading import LANDMARK_FILE, Reader, load_reader
from pssf.reader.landmark_agreement import compare_landmarks, select_annotated_knee, summarise_agreement
from pssf.reader.networks import load_network
from pssf.reader_training.hold_out import measure_hold_out
from pssf.reader_training.reader_maker import train_landmark_network
from pssf.reader_training.training_images import TrainingImages, read_training_images
from pssf.reader_training.training_settings import ReaderTrainingSettings

Row = dict[str, Any]
_ROW_FILE = "row.json"
# Columns of the agreement with annotations that are kept.
_KEPT = (
    *("median_mm", "p90_mm", "below_1_mm", "below_1_5_mm", "below_2_5_mm", "auc"),
    *("medial_gap_bias_mm", "medial_gap_mae_mm", "medial_gap_correlation"),
    *("lateral_gap_bias_mm", "lateral_gap_mae_mm", "lateral_gap_correlation"),
)
# Input sizes with pixels of about 0.68, 0.45 and 0.34 mm for a plateau of 76 mm: side and plateau width, in pixels.
_INPUTS = ((192, 112.0), (288, 168.0), (384, 224.0))
_WIDTHS = (12, 20, 32)
_RECIPES = ("none", "mild", "strong")
_FRACTIONS = (0.125, 0.25, 0.5, 1.0)


def list_variants(base: ReaderTrainingSettings) -> Iterator[tuple[str, ReaderTrainingSettings, float]]:
    """List the variants: name, settings and fraction of the images; the base comes first."""
    yield "base", base, 1.0
    for crop_px, plateau_px in _INPUTS:
        if crop_px != base.crop_px:
            yield f"input {crop_px} px", replace(base, crop_px=crop_px, plateau_px=plateau_px), 1.0
    for width in _WIDTHS:
        if width != base.width:
            yield f"width {width}", replace(base, width=width), 1.0
    for recipe in _RECIPES:
        if recipe != base.randomisation:
            yield f"randomisation {recipe}", replace(base, randomisation=recipe), 1.0
    yield "without deformation", replace(base, deformation_sd=0.0), 1.0
    for fraction in _FRACTIONS[:-1]:
        yield f"{fraction:.1%} of the images", base, fraction


def select_images(images: TrainingImages, fraction: float) -> TrainingImages:
    """Return the first images, by fraction of their number."""
    return take_images(images, slice(round(fraction * len(images.crops))))


def take_images(images: TrainingImages, part: slice) -> TrainingImages:
    """Return a part of the images."""
    return TrainingImages(**{name: values[part] for name, values in vars(images).items()})


def measure_films(reader: Reader, films: Path, annotations: list[LandmarkAnnotation]) -> Row:
    """Read annotated radiographs, and summarise the agreement."""
    rows = []
    for annotation in annotations:
        knee = select_annotated_knee(read(films / annotation.file, reader=reader), annotation.side)
        rows.append(compare_landmarks(knee, annotation.landmarks_mm, annotation.side))
    summary = summarise_agreement(rows, [annotation.grade for annotation in annotations])[0]
    return {name: summary.get(name) for name in _KEPT}


def main(
    out: Path,
    data: Annotated[Path, typer.Option()],
    films: Annotated[Path, typer.Option()],
    compare: Annotated[Path, typer.Option()],
    networks: Annotated[Path | None, typer.Option()] = None,
    steps: Annotated[int, typer.Option()] = 2000,
    threads: Annotated[int, typer.Option()] = 1,
    variant: Annotated[list[str] | None, typer.Option()] = None,
) -> None:
    """Train and measure all variants, or those that are named."""
    record = start_run_record()
    torch.set_num_threads(threads)
    base = ReaderTrainingSettings(landmark_steps=steps, threads=threads)
    training, tests = read_training_images(data, "train"), read_training_images(data, "test")
    annotations, given = read_landmark_annotations(compare, CONTOUR_LANDMARKS), load_reader(networks)
    rows: list[Row] = []
    for name, settings, fraction in list_variants(base):
        if variant and name not in variant:
            continue
        folder = make_folder(out / name.replace(" ", "_").replace("%", ""))
        if (folder / _ROW_FILE).is_file():
            rows.append(json.loads((folder / _ROW_FILE).read_text()))
            continue
        images, began = select_images(training, fraction), perf_counter()
        network = train_landmark_network(images, settings, folder, lambda *_: None)
        seconds = perf_counter() - began
        errors = measure_hold_out(network, tests, settings)
        reader = replace(given, landmarks=load_network(folder / LANDMARK_FILE))
        rows.append(
            {
                "variant": name,
                "images": len(images.crops),
                "parameters": sum(values.numel() for values in network.parameters()),
                "training_s": round(seconds),
                "simulated_mm": float(np.mean(list(errors.landmark_mm.values()))),
                **measure_films(reader, films, annotations),
            }
        )
        write_json(folder / _ROW_FILE, rows[-1])
        print(rows[-1], flush=True)
    if not variant:
        write_csv(out / "reader_ablation.csv", rows)
        record.save(out)


if __name__ == "__main__":
    typer.run(main)
