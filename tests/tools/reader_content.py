"""Ablation of the simulation: train the landmark network on images that lack one part of the simulation.

Run ``python -m tools.reader_content OUT --films FILMS --compare ANNOTATIONS`` in the folder ``tests``. FILMS is a
folder of radiographs, and ANNOTATIONS their table of landmarks (see ``pssf landmarks --compare``). All variants have
the same knees. The command writes OUT/reader_content.csv; a repeated run continues where it stopped. It needs the extra
``train``.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from tools.reader_ablation import measure_films, take_images

import pssf
from pssf.core.label_names import CONTOUR_LANDMARKS
from pssf.core.processes.parallel_map import map_in_parallel
from pssf.core.random_streams import make_stream
from pssf.data.imaging.display_table import FlatPanelProcessing
from pssf.dataset.dataset_plan import PlannedImage, plan_subject
from pssf.dataset.dataset_settings import DatasetSettings
from pssf.dataset.dataset_tables import DatasetTables, load_dataset_tables
from pssf.dataset.sample import DISPLAY_KEY
from pssf.io.atomic_write import make_folder
from pssf.io.cohort_records import write_csv
from pssf.io.patients.landmark_annotations import read_landmark_annotations
from pssf.io.run_record import start_run_record
from pssf.model.sampling.display_sampling import sample_processing_from_table
from pssf.raycast.detector_clearance import move_clear_of_detector
from pssf.reader.knee_reading import LANDMARK_FILE, load_reader
from pssf.reader.networks import load_network
from pssf.reader_training.hold_out import measure_hold_out
from pssf.reader_training.reader_maker import train_landmark_network
from pssf.reader_training.training_images import BONES, TrainingImages, collect_training_images, prepare_image
from pssf.reader_training.training_settings import ReaderTrainingSettings

Row = dict[str, Any]
VARIANTS = ("all", "without texture", "without scatter", "uniform soft tissue", "one display", "one acquisition")
# Fields of the protocol that a variant changes; the other variants have the pixels of the complete simulation.
_CHANGED_PHYSICS: dict[str, dict[str, Any]] = {
    "without texture": {"texture": "none"},
    "without scatter": {"scatter": "none"},
    "uniform soft tissue": {},
}
# Subjects that are made and stored together, and number of knees for the errors on simulations.
_CHUNK = 20
_TESTS = 60
_MATRIX = 512


def plan_knee(number: int, acquisition: str) -> tuple[PlannedImage, DatasetTables]:
    """Plan one subject of a data set with sampled or fixed acquisitions."""
    settings = DatasetSettings(images=100_000, matrix=_MATRIX, kinds=("display",), acquisition=acquisition)
    tables = load_dataset_tables(settings)
    (planned,) = plan_subject(settings, tables, number, "train", attempt=0)
    return planned, tables


def make_variants(number: int) -> dict[str, dict[str, Any]] | None:
    """Make the images of one subject in all variants; None if its knee cannot be built."""
    try:
        images = {}
        for acquisition, names in (("sampled", VARIANTS[:-1]), ("fixed", VARIANTS[-1:])):
            planned, tables = plan_knee(number, acquisition)
            built = pssf.build(planned.knee, planned.protocol)
            protocol = move_clear_of_detector(built.scene, built.aim_beam(planned.protocol))
            complete = pssf.simulate(built, protocol, rng=planned.seed, workers=1, keep=("masks",))
            for name in names:
                images[name] = _make_image(name, built, complete, planned, tables)
    except pssf.InputError:
        return None
    return images


def _make_image(
    name: str, built: pssf.BuiltKnee, complete: pssf.Radiograph, planned: PlannedImage, tables: DatasetTables
) -> dict[str, Any]:
    """Prepare one variant; `complete` is the radiograph with all parts, and has the labels of all variants."""
    protocol, truth, radiograph = complete.protocol, complete.truth, complete
    assert truth is not None
    if name in _CHANGED_PHYSICS:
        scene = _make_tissue_uniform(built.scene) if name == "uniform soft tissue" else built
        changed = replace(protocol, **_CHANGED_PHYSICS[name])
        radiograph = pssf.simulate(scene, changed, rng=planned.seed, workers=1)
    processing: str | FlatPanelProcessing = "processed"
    if name != "one display":
        rng = make_stream(planned.appearance_seed, DISPLAY_KEY)
        processing = sample_processing_from_table(tables.display, rng=rng)
    display = pssf.render_for_display(radiograph, processing=processing).astype(np.uint8)
    coded = np.zeros(display.shape, np.uint8)
    for bit, bone in enumerate(BONES):
        coded |= truth.masks[bone].astype(np.uint8) << bit
    landmarks = np.array([truth.landmarks_px[name] for name in CONTOUR_LANDMARKS])
    return prepare_image(display, landmarks, coded, planned.knee.side, protocol.pixel_mm)


def _make_tissue_uniform(scene: pssf.Scene) -> pssf.Scene:
    """Return the bones of a scene in a limb that contains only muscle."""
    skin = next(one for one in scene.surfaces if one.name == "skin")
    bones = [one for one in scene.surfaces if one.name.split("_")[0] in BONES and "cartilage" not in one.name]
    # The outer surface of a bone may touch several soft tissues.
    inside = [replace(one, outside="muscle") if one.name in BONES else one for one in bones]
    return replace(scene, surfaces=(replace(skin, inside="muscle"), *inside))


def load_images(out: Path, knees: int, workers: int) -> dict[str, TrainingImages]:
    """Load the images of all variants, and make those that are missing."""
    chunks = []
    for first in range(0, knees + _TESTS, _CHUNK):
        path = out / f"images-{first:05d}.npz"
        if not path.is_file():
            made = map_in_parallel(make_variants, range(first, first + _CHUNK), workers=workers)
            complete = [one for one in made if one is not None]
            joined = {name: vars(collect_training_images([one[name] for one in complete])) for name in VARIANTS}
            np.savez(path, **{f"{name}/{key}": values for name in joined for key, values in joined[name].items()})
            print(f"images: {first + _CHUNK} of {knees + _TESTS}", flush=True)
        chunks.append(np.load(path))
    return {
        name: TrainingImages(
            **{
                key: np.concatenate([chunk[f"{name}/{key}"] for chunk in chunks])
                for key in TrainingImages.__dataclass_fields__
            }
        )
        for name in VARIANTS
    }


def train_variants(out: Path, images: dict[str, TrainingImages], settings: ReaderTrainingSettings) -> Iterator[Row]:
    """Train one network for each variant, and measure it on the simulations with all parts."""
    tests = take_images(images["all"], slice(-_TESTS, None))
    for name in VARIANTS:
        train = take_images(images[name], slice(-_TESTS))
        folder = make_folder(out / name.replace(" ", "_"))
        network = train_landmark_network(train, settings, folder, lambda *_: None)
        errors = measure_hold_out(network, tests, settings)
        yield {
            "variant": name,
            "images": len(train.crops),
            "simulated_mm": float(np.mean(list(errors.landmark_mm.values()))),
            "network": folder / LANDMARK_FILE,
        }


def main(
    out: Path,
    films: Annotated[Path, typer.Option()],
    compare: Annotated[Path, typer.Option()],
    knees: Annotated[int, typer.Option()] = 400,
    steps: Annotated[int, typer.Option()] = 1200,
    workers: Annotated[int, typer.Option()] = 2,
    threads: Annotated[int, typer.Option()] = 1,
) -> None:
    """Make the images of all variants, and train and measure one network for each."""
    record = start_run_record()
    torch.set_num_threads(threads)
    images = load_images(make_folder(out), knees, workers)
    annotations, given = read_landmark_annotations(compare, CONTOUR_LANDMARKS), load_reader()
    rows: list[Row] = []
    for row in train_variants(out, images, ReaderTrainingSettings(landmark_steps=steps, threads=threads)):
        reader = replace(given, landmarks=load_network(row.pop("network")))
        rows.append(row | measure_films(reader, films, annotations))
        print(rows[-1], flush=True)
    write_csv(out / "reader_content.csv", rows)
    record.save(out)


if __name__ == "__main__":
    typer.run(main)
