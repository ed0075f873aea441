"""Run the networks of the reader with ONNX Runtime, and decode their output."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..core.checks import Array, InputError
from .knee_frame import Grey

# Half the side of the window around the highest value of a heat map, in pixels of the heat map; values outside the
# window do not contribute to the position.
_WINDOW_PX = 6
# Name of the entry of an ONNX file that contains the settings of a network.
_SETTINGS_ENTRY = "pssf"


class NetworkSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of a network that are stored in its ONNX file.

    Attributes
    ----------
    crop_px : int
        Side of the input image, in pixels.
    plateau_px : float
        Width of the tibial plateau in the input image, in pixels; 0 for the network that finds knees.
    stride : int
        Input pixels per output pixel.
    landmarks : tuple of str
        Name of each heat map.
    masks : tuple of str
        Name of each mask.
    """

    crop_px: int
    plateau_px: float
    stride: int
    landmarks: tuple[str, ...]
    masks: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Network:
    """Loaded network.

    Attributes
    ----------
    session : onnxruntime.InferenceSession
        Session that runs the network.
    settings : NetworkSettings
        Settings of the network.
    """

    session: Any
    settings: NetworkSettings

    def run(self, crop: Grey) -> tuple[Grey, Grey]:
        """Apply the network to one image.

        Parameters
        ----------
        crop : (crop_px, crop_px) float32 array
            Normalised grey values.

        Returns
        -------
        heat_maps : (landmarks, rows, cols) float32 array
            Logits of the position of each landmark.
        masks : (masks, rows, cols) float32 array
            Logits of each mask.
        """
        heat_maps, masks = self.session.run(None, {"image": crop[None, None]})
        return heat_maps[0], masks[0]


def load_network(path: Path, threads: int = 1) -> Network:
    """Load a network from an ONNX file.

    Parameters
    ----------
    path : Path
        ONNX file written by ``pssf train-reader``.
    threads : int, default 1
        Number of threads; it does not affect the landmarks beyond rounding.

    Returns
    -------
    Network
        Network that is ready to run.

    Raises
    ------
    InputError
        ONNX Runtime is not installed, or the file is missing, damaged or not a network of the reader.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise InputError(f"the reader needs ONNX Runtime, got {error}: pip install 'pssf[reader]'") from error
    if not path.is_file():
        raise InputError(f"file {path} must be a network of the reader, got no file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = threads
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        stored = session.get_modelmeta().custom_metadata_map[_SETTINGS_ENTRY]
        return Network(session=session, settings=msgspec.json.decode(stored, type=NetworkSettings))
    except Exception as error:  # ONNX Runtime raises classes that are not public.
        raise InputError(f"file {path} must be a network of the reader, got {type(error).__name__}") from error


def describe_settings(settings: NetworkSettings) -> Mapping[str, str]:
    """Return the metadata entry under which `load_network` expects the settings.

    Parameters
    ----------
    settings : NetworkSettings
        Settings of the network.

    Returns
    -------
    mapping of str to str
        Metadata of the ONNX file.
    """
    return {_SETTINGS_ENTRY: msgspec.json.encode(settings).decode()}


@dataclass(frozen=True, kw_only=True, eq=False)
class DecodedHeatMaps:
    """Positions of landmarks in heat maps.

    Attributes
    ----------
    places_px : (n, 2) array
        Row and column of each landmark in the input image of the network, in pixels.
    spread_px : (n,) array
        Standard deviation of the position along both axes, in pixels of the input image.
    mass : (n,) array
        Probability within the window around the highest value, 0 to 1.
    """

    places_px: Array
    spread_px: Array
    mass: Array


def decode_heat_maps(logits: NDArray[np.floating], stride: int) -> DecodedHeatMaps:
    """Compute the expected position of each landmark (soft argmax within a window around the highest value).

    Parameters
    ----------
    logits : (n, rows, cols) array
        Logits of the position; the softmax over all pixels is the probability.
    stride : int
        Input pixels per pixel of the heat map.

    Returns
    -------
    DecodedHeatMaps
        Positions, their spread and the probability within the window.
    """
    n, rows, cols = logits.shape
    probability = np.exp(logits - logits.max(axis=(1, 2), keepdims=True, initial=-np.inf))
    probability = probability / probability.sum(axis=(1, 2), keepdims=True)
    peak = np.stack(np.unravel_index(probability.reshape(n, -1).argmax(axis=1), (rows, cols)), axis=1)
    near = (np.abs(np.arange(rows) - peak[:, :1]) <= _WINDOW_PX)[:, :, None] & (
        np.abs(np.arange(cols) - peak[:, 1:]) <= _WINDOW_PX
    )[:, None, :]
    windowed = np.where(near, probability, 0.0)
    mass = windowed.sum(axis=(1, 2))
    windowed = windowed / mass[:, None, None]
    row_share, col_share = windowed.sum(axis=2), windowed.sum(axis=1)
    places = np.column_stack((row_share @ np.arange(rows), col_share @ np.arange(cols)))
    squares = row_share @ np.arange(rows) ** 2 + col_share @ np.arange(cols) ** 2 - (places**2).sum(axis=1)
    # With pixel unshuffling, pixel k of the heat map covers pixels stride k to stride k + stride - 1 of the input.
    spread = np.sqrt(np.maximum(squares, 0.0) / 2)
    return DecodedHeatMaps(places_px=places * stride + (stride - 1) / 2, spread_px=spread * stride, mass=mass)
