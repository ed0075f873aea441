"""Continue the training of the landmark network on radiographs with corrected landmarks."""

from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from ..core.checks import InputError
from ..core.label_names import CONTOUR_LANDMARKS
from ..io.atomic_write import copy_file, make_folder
from ..io.cohort_records import claim_folder, hash_file, write_csv
from ..io.landmark_files import read_pts
from ..io.patients.patient_list import Film
from ..io.patients.patient_radiographs import read_film
from ..reader.knee_frame import PLATEAU_EDGES, fit_frame, normalise_grey
from ..reader.knee_reading import LANDMARK_FILE, LOCATOR_FILE, SIDE_FILE, draw_masks
from ..reader.networks import Network, load_network
from ..reader.reader_table import TABLE_FILE
from .grey_randomisation import build_grey_randomisation
from .hold_out import predict_places
from .landmark_batches import make_landmark_batch
from .reader_maker import SETTINGS_FILE, Report, compute_batch_loss, train_and_export
from .training_images import TrainingImages, collect_training_images, prepare_image
from .training_settings import FineTuningSettings
from .unet import ReaderUNet

# Folder with the landmark files, beside the radiographs, as `pssf landmarks` writes it.
POINTS_FOLDER = "points"
ERRORS_FILE = "fine_tuning.csv"
# Fraction of the subjects that are kept for the errors.
_KEPT_FRACTION = 0.2
_LEAST_SUBJECTS = 5
# Quantiles of the grey values of a radiograph that become black and white.
_GREY_QUANTILES = (0.001, 0.999)


@dataclass(frozen=True, kw_only=True)
class FineTuningErrors:
    """Mean distance of the landmarks on the radiographs that were not used, in percent of the plateau width.

    Attributes
    ----------
    knees : int
        Number of knees.
    before, after : float
        Mean distance before and after the training.
    """

    knees: int
    before: float
    after: float


def fine_tune_reader(
    films: list[Film], points: Path, networks: Path, settings: FineTuningSettings, folder: Path, report: Report
) -> FineTuningErrors:
    """Continue the training of a reader on annotated radiographs, and write the new reader.

    The masks of the bones are those that the present network draws around the annotated landmarks. One subject in five
    is not used for training.

    Parameters
    ----------
    films : list of Film
        Radiographs.
    points : Path
        Folder with a file NAME_right.pts or NAME_left.pts for each knee.
    networks : Path
        Folder of the present reader.
    settings : FineTuningSettings
        Settings of the training.
    folder : Path
        Output folder; an interrupted training continues from its checkpoint.
    report : callable
        Function of the name of the network, finished steps, all steps and mean loss.

    Returns
    -------
    FineTuningErrors
        Errors before and after.

    Raises
    ------
    InputError
        A file cannot be read, there are fewer than five subjects, or the checkpoint has other settings.
    """
    torch.set_num_threads(settings.threads)
    path = networks / LANDMARK_FILE
    present = load_network(path)
    images, subjects, files = _read_knees(films, points, present)
    kept = choose_kept_subjects(subjects, settings.seed)
    make_folder(folder)
    hashes = sorted(hash_file(name) for name in (*files, path))
    claim_folder(folder / SETTINGS_FILE, asdict(settings) | {"sha256": hashes, "pssf": version("pssf")})
    network = load_exported_network(path, present)
    crop_px, plateau_px = present.settings.crop_px, present.settings.plateau_px
    before = _measure_share(network, images, kept, present)
    randomise, used = build_grey_randomisation(settings.randomisation), np.flatnonzero(~kept)

    def compute_loss(net: nn.Module, rng: np.random.Generator) -> Tensor:
        chosen = rng.choice(used, size=settings.batch)
        made = make_landmark_batch(images, chosen, crop_px=crop_px, plateau_px=plateau_px, randomise_grey=randomise)
        return compute_batch_loss(net, made)

    written = folder / LANDMARK_FILE
    train_and_export(
        network, compute_loss, settings, present.settings, written, report, steps=settings.steps, seed=settings.seed
    )
    for name in (LOCATOR_FILE, SIDE_FILE, TABLE_FILE):
        copy_file(networks / name, folder / name)
    errors = FineTuningErrors(
        knees=int(kept.sum()), before=before, after=_measure_share(network, images, kept, present)
    )
    write_csv(folder / ERRORS_FILE, [asdict(errors)])
    return errors


def choose_kept_subjects(subjects: list[str], seed: int) -> np.ndarray:
    """Choose the knees that are not used for training: one subject in five, with all radiographs.

    Parameters
    ----------
    subjects : list of str
        Subject of each knee.
    seed : int
        Seed of the choice.

    Returns
    -------
    (n,) bool array
        Knees that are kept for the errors.

    Raises
    ------
    InputError
        There are fewer than five subjects.
    """
    names = sorted(set(subjects))
    if len(names) < _LEAST_SUBJECTS:
        raise InputError(f"fine-tuning needs annotated knees of at least {_LEAST_SUBJECTS} subjects, got {len(names)}")
    order = np.random.default_rng(seed).permutation(len(names))
    chosen = {names[k] for k in order[: max(1, round(_KEPT_FRACTION * len(names)))]}
    return np.array([subject in chosen for subject in subjects])


def load_exported_network(path: Path, present: Network) -> ReaderUNet:
    """Load the weights of an ONNX file into a network that can be trained.

    The export has merged each batch normalisation with its convolution. The network therefore has none.

    Parameters
    ----------
    path : Path
        ONNX file written by ``pssf train-reader``.
    present : Network
        The loaded file.

    Returns
    -------
    ReaderUNet
        Network that gives the same logits.
    """
    stored = {entry.name: entry for entry in onnx.load(path).graph.initializer}
    weights = {name: torch.from_numpy(onnx.numpy_helper.to_array(entry).copy()) for name, entry in stored.items()}
    settings = present.settings
    network = ReaderUNet(len(settings.landmarks), len(settings.masks), len(weights["body.final_conv.weight"][0]))
    for module in network.modules():
        for name, child in module.named_children():
            if isinstance(child, nn.BatchNorm2d):
                setattr(module, name, nn.Identity())
    network.load_state_dict({name: weights[name] for name in network.state_dict()})
    return network


def _read_knees(films: list[Film], points: Path, present: Network) -> tuple[TrainingImages, list[str], list[Path]]:
    """Read the annotated knees; also return the subject of each knee and the files."""
    prepared, subjects, files = [], [], []
    for film in films:
        stem = Path(film.file).stem
        for side in ("right", "left"):
            annotated = points / f"{stem}_{side}.pts"
            if annotated.exists():
                prepared.append(_prepare_film(film, annotated, side, present))
                subjects.append(film.subject)
                files += [Path(film.file), annotated]
    if not prepared:
        raise InputError(
            f"folder {points} must have files NAME_right.pts or NAME_left.pts of the radiographs, got none"
        )
    return collect_training_images(prepared), subjects, files


def _prepare_film(film: Film, annotated: Path, side: str, present: Network) -> dict[str, np.ndarray]:
    """Prepare one knee, with the masks that the present network draws."""
    image = read_film(film.file)
    named = read_pts(annotated, CONTOUR_LANDMARKS)
    places = np.array([named[name] for name in CONTOUR_LANDMARKS])
    grey = np.interp(image.pixels, np.quantile(image.pixels, _GREY_QUANTILES), (0, 255)).astype(np.float32)
    settings, frame = present.settings, fit_frame(places[PLATEAU_EDGES], side)
    _, logits = present.run(normalise_grey(*frame.cut_crop(grey, settings.plateau_px, settings.crop_px)))
    masks = np.zeros(grey.shape, np.uint8)
    for bit, mask in enumerate(draw_masks(logits, frame, settings, grey.shape).values()):
        masks |= mask.astype(np.uint8) << bit
    return prepare_image(np.rint(grey).astype(np.uint8), places, masks, side, film.pixel_mm or 1.0)


def _measure_share(network: nn.Module, images: TrainingImages, kept: np.ndarray, present: Network) -> float:
    """Measure the mean distance of the landmarks of the kept knees, in percent of the plateau width."""
    network.eval()
    found_px, true_px, _ = predict_places(
        network, images, np.flatnonzero(kept), present.settings.crop_px, present.settings.plateau_px
    )
    return float(100 * np.linalg.norm(found_px - true_px, axis=2).mean() / present.settings.plateau_px)
