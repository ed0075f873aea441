"""Write a network of the reader as ONNX, with its settings in the file."""

from pathlib import Path

import onnx
import torch

from ..reader.networks import NetworkSettings, describe_settings
from .side_network import SideNetwork
from .unet import ReaderUNet

_OPSET = 18


def export_network(network: ReaderUNet | SideNetwork, settings: NetworkSettings, path: Path) -> None:
    """Write a network as ONNX.

    Parameters
    ----------
    network : ReaderUNet or SideNetwork
        Trained network.
    settings : NetworkSettings
        Settings that `reader.networks.load_network` needs.
    path : Path
        File to write.
    """
    network.eval()
    example = torch.zeros(1, 1, settings.crop_px, settings.crop_px)
    program = torch.onnx.export(
        network,
        (example,),
        input_names=["image"],
        output_names=["heat_maps", "masks"],
        opset_version=_OPSET,
        dynamo=True,
    )
    assert program is not None
    model = program.model_proto
    for name, value in describe_settings(settings).items():
        entry = model.metadata_props.add()
        entry.key, entry.value = name, value
    part = path.with_suffix(".part")
    onnx.save(model, part)
    part.replace(path)
