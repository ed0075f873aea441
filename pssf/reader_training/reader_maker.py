"""Train the networks of the reader on a simulated data set, and write them as ONNX."""

from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

import msgspec
import numpy as np
import torch
from torch import Tensor, nn

from ..core.label_names import CONTOUR_LANDMARKS
from ..io.atomic_write import make_folder
from ..io.cohort_records import claim_folder, hash_file, write_csv, write_json
from ..io.dataset_files import SETTINGS_FILE as DATASET_FILE
from ..reader.knee_reading import LANDMARK_FILE, LOCATOR_FILE, SIDE_FILE
from ..reader.networks import NetworkSettings, load_network
from ..reader.reader_table import TABLE_FILE, ReaderTable
from .grey_randomisation import build_grey_randomisation
from .hold_out import HoldOutErrors, measure_hold_out
from .landmark_batches import LandmarkBatch, make_landmark_batch
from .locator_batches import EDGE_CHANNELS, make_locator_batch
from .losses import compute_edge_loss, compute_landmark_loss
from .reader_export import export_network
from .reader_thresholds import set_thresholds
from .side_network import SideNetwork, compute_side_loss
from .training_images import BONES, TrainingImages, read_displays, read_training_images
from .training_loop import ComputeLoss, train_network
from .training_settings import FineTuningSettings, ReaderTrainingSettings
from .unet import STRIDE, ReaderUNet

SETTINGS_FILE = "training.json"
ERRORS_FILE = "reader_simulated.csv"
# Side of the input of the network that finds knees, in pixels, and its number of feature maps.
_LOCATOR_PX = 192
_LOCATOR_WIDTH = 12
# Side of the input of the side network, width of its plateau, in pixels, and number of crops per step. The pixels are
# coarse, so that shape decides and not texture.
_SIDE_PX = 72
_SIDE_PLATEAU_PX = 36.0
_SIDE_BATCH = 16
# Initial bias of the heat maps of the locator, divided by the factor of the logits: few pixels contain an edge.
_LOCATOR_BIAS = -0.4

Report = Callable[[str, int, int, float], None]


def compute_batch_loss(network: nn.Module, made: LandmarkBatch) -> Tensor:
    """Compute the loss of the landmark network on a batch.

    Parameters
    ----------
    network : torch.nn.Module
        Landmark network.
    made : LandmarkBatch
        Batch with its labels.

    Returns
    -------
    scalar tensor
        Loss.
    """
    heat_maps, masks = network(made.image)
    return compute_landmark_loss(heat_maps, masks, made.places_px, made.visible, made.bones, made.inside)


def train_landmark_network(
    images: TrainingImages, settings: ReaderTrainingSettings, folder: Path, report: Report
) -> ReaderUNet:
    """Train the network that finds landmarks and masks, and write it.

    Parameters
    ----------
    images : TrainingImages
        Images for training.
    settings : ReaderTrainingSettings
        Settings of the training.
    folder : Path
        Folder for checkpoint and network.
    report : callable
        Function of the name of the network, finished steps, all steps and mean loss.

    Returns
    -------
    ReaderUNet
        Trained network.
    """
    torch.manual_seed(settings.seed)
    network = ReaderUNet(len(CONTOUR_LANDMARKS), len(BONES), settings.width)
    randomise = build_grey_randomisation(settings.randomisation)

    def compute_loss(net: nn.Module, rng: np.random.Generator) -> Tensor:
        chosen = rng.integers(len(images.crops), size=settings.batch)
        made = make_landmark_batch(
            images,
            chosen,
            crop_px=settings.crop_px,
            plateau_px=settings.plateau_px,
            randomise_grey=randomise,
            deformation_sd=settings.deformation_sd,
        )
        return compute_batch_loss(net, made)

    described = NetworkSettings(
        crop_px=settings.crop_px,
        plateau_px=settings.plateau_px,
        stride=STRIDE,
        landmarks=CONTOUR_LANDMARKS,
        masks=BONES,
    )
    path, steps = folder / LANDMARK_FILE, settings.landmark_steps
    train_and_export(network, compute_loss, settings, described, path, report, steps=steps, seed=settings.seed)
    return network


def train_locator(images: TrainingImages, settings: ReaderTrainingSettings, folder: Path, report: Report) -> ReaderUNet:
    """Train the network that finds knees, and write it.

    Parameters
    ----------
    images : TrainingImages
        Images for training.
    settings : ReaderTrainingSettings
        Settings of the training.
    folder : Path
        Folder for checkpoint and network.
    report : callable
        Function of the name of the network, finished steps, all steps and mean loss.

    Returns
    -------
    ReaderUNet
        Trained network.
    """
    torch.manual_seed(settings.seed)
    network = ReaderUNet(len(EDGE_CHANNELS), 0, _LOCATOR_WIDTH)
    nn.init.constant_(network.body.final_conv.bias, _LOCATOR_BIAS)
    randomise = build_grey_randomisation(settings.randomisation)

    def compute_loss(net: nn.Module, rng: np.random.Generator) -> Tensor:
        image, edges = make_locator_batch(images, settings.batch, _LOCATOR_PX, rng, randomise)
        return compute_edge_loss(net(image)[0], edges)

    described = NetworkSettings(crop_px=_LOCATOR_PX, plateau_px=0.0, stride=STRIDE, landmarks=EDGE_CHANNELS, masks=())
    path, steps = folder / LOCATOR_FILE, settings.locator_steps
    train_and_export(network, compute_loss, settings, described, path, report, steps=steps, seed=settings.seed + 1)
    return network


def train_side_network(
    images: TrainingImages, settings: ReaderTrainingSettings, folder: Path, report: Report
) -> SideNetwork:
    """Train the network that tells right from left knees, and write it.

    Parameters
    ----------
    images : TrainingImages
        Images for training.
    settings : ReaderTrainingSettings
        Settings of the training.
    folder : Path
        Folder for checkpoint and network.
    report : callable
        Function of the name of the network, finished steps, all steps and mean loss.

    Returns
    -------
    SideNetwork
        Trained network.
    """
    torch.manual_seed(settings.seed)
    network, randomise = SideNetwork(), build_grey_randomisation(settings.randomisation)

    def compute_loss(net: nn.Module, rng: np.random.Generator) -> Tensor:
        chosen = rng.integers(len(images.crops), size=_SIDE_BATCH)
        made = make_landmark_batch(
            images,
            chosen,
            crop_px=_SIDE_PX,
            plateau_px=_SIDE_PLATEAU_PX,
            randomise_grey=randomise,
            deformation_sd=settings.deformation_sd,
        )
        return compute_side_loss(net, made.image)

    described = NetworkSettings(crop_px=_SIDE_PX, plateau_px=_SIDE_PLATEAU_PX, stride=1, landmarks=("right",), masks=())
    path, steps = folder / SIDE_FILE, settings.side_steps
    train_and_export(network, compute_loss, settings, described, path, report, steps=steps, seed=settings.seed + 2)
    return network


def train_and_export(
    network: ReaderUNet | SideNetwork,
    compute_loss: ComputeLoss,
    settings: ReaderTrainingSettings | FineTuningSettings,
    described: NetworkSettings,
    path: Path,
    report: Report,
    *,
    steps: int,
    seed: int,
) -> None:
    """Train a network with a checkpoint beside its file, and write it.

    Parameters
    ----------
    network : ReaderUNet or SideNetwork
        Network; it is changed in place.
    compute_loss : callable
        Function of the network and a random generator that makes a batch and returns its loss.
    settings : ReaderTrainingSettings or FineTuningSettings
        Settings with the learning rate.
    described : NetworkSettings
        Settings that are stored in the file.
    path : Path
        File to write.
    report : callable
        Function of the name of the network, finished steps, all steps and mean loss.
    steps : int
        Number of steps.
    seed : int
        Seed of all random numbers.
    """
    train_network(
        network,
        compute_loss,
        steps=steps,
        learning_rate=settings.learning_rate,
        seed=seed,
        checkpoint=path.with_suffix(".pt"),
        report=lambda done, of, loss: report(path.stem, done, of, loss),
    )
    export_network(network, described, path)


def make_reader(
    data: Path, settings: ReaderTrainingSettings, folder: Path, report: Report, workers: int = 1
) -> tuple[HoldOutErrors, ReaderTable]:
    """Train the reader on a data set, and write networks, thresholds and errors.

    Parameters
    ----------
    data : Path
        Folder of a complete data set with images for display.
    settings : ReaderTrainingSettings
        Settings of the training.
    folder : Path
        Output folder; an interrupted training continues from its checkpoints.
    report : callable
        Function of the name of the network, finished steps, all steps and mean loss.
    workers : int, default 1
        Number of processes that prepare images.

    Returns
    -------
    errors : HoldOutErrors
        Errors on simulated radiographs of the subset for tests.
    table : ReaderTable
        Mean shape and thresholds.

    Raises
    ------
    InputError
        The folder contains no complete data set, or its checkpoints were made with other settings.
    """
    make_folder(folder)
    specified = asdict(settings) | {"dataset_sha256": hash_file(data / DATASET_FILE), "pssf": version("pssf")}
    claim_folder(folder / SETTINGS_FILE, specified)
    torch.set_num_threads(settings.threads)
    images = read_training_images(data, "train", workers)
    network = train_landmark_network(images, settings, folder, report)
    train_locator(images, settings, folder, report)
    train_side_network(images, settings, folder, report)
    table = set_thresholds(
        load_network(folder / LOCATOR_FILE),
        load_network(folder / SIDE_FILE),
        load_network(folder / LANDMARK_FILE),
        images,
        read_displays(data, "validation"),
        settings.seed,
    )
    write_json(folder / TABLE_FILE, msgspec.to_builtins(table))
    errors = measure_hold_out(network, read_training_images(data, "test", workers), settings)
    write_csv(folder / ERRORS_FILE, errors.rows())
    return errors, table
