"""Train a U-Net of MONAI to segment a knee, with images that are simulated during training."""

import json
from pathlib import Path

import numpy as np
import torch
from monai.losses import DiceCELoss
from monai.networks.nets import UNet
from monai.transforms import Compose, EnsureChannelFirstd, RandGaussianNoised, RandScaleIntensityd, ScaleIntensityd
from torch.utils.data import DataLoader

from pssf.dataset import DatasetSettings
from pssf.torch import KneeStream

EPOCHS = 3


def run(out: Path, pixels: int = 2048, images: int = 12) -> list[Path]:
    """Train for three epochs with `images` new images of `pixels` / 8 pixels per side, and write the losses."""
    transform = Compose(
        [
            EnsureChannelFirstd("label_map", channel_dim="no_channel"),
            ScaleIntensityd("image"),
            RandScaleIntensityd("image", factors=0.2, prob=0.5),
            RandGaussianNoised("image", std=0.03, prob=0.5),
        ]
    ).set_random_state(seed=0)
    # The size of the crop is divisible by 4, because two levels of the U-Net halve the image.
    settings = DatasetSettings(images=images, matrix=pixels // 8, crop_mm=140, randomise=("affine",), seed=2)
    stream = KneeStream(settings, transform=transform)
    kinds = max(stream.label_map.values()) + 1
    torch.manual_seed(0)
    network = UNet(2, in_channels=1, out_channels=kinds, channels=(8, 16, 32), strides=(2, 2), num_res_units=1)
    optimiser, loss_of = torch.optim.AdamW(network.parameters(), lr=5e-3), DiceCELoss(to_onehot_y=True, softmax=True)
    history = []
    for epoch in range(EPOCHS):
        losses = []
        for batch in DataLoader(stream, batch_size=2):
            loss = loss_of(network(batch["image"]), batch["label_map"])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(float(loss.detach()))
        history.append(float(np.mean(losses)))
        print(f"epoch {epoch + 1}: loss {history[-1]:.2f}")
    path = out / "train_monai.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"loss": history}) + "\n")
    return [path]


if __name__ == "__main__":
    run(Path("runs/examples"))
