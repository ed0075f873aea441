"""Train a network to measure the medial joint space, with augmentations of TorchIO."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torchio as tio
from torch import nn
from torch.utils.data import DataLoader

from pssf.dataset import DatasetSettings, make_dataset
from pssf.torch import KneeDataset

EPOCHS = 3
AUGMENT = tio.Compose(
    [tio.RandomGamma(log_gamma=0.3), tio.RandomNoise(std=0.03), tio.RandomBlur(std=(0, 1, 0, 1, 0, 0))]
)


def augment(item: dict[str, Any]) -> dict[str, Any]:
    """Augment the image of an item. TorchIO expects volumes, so the image gets a third axis."""
    subject = tio.Subject(image=tio.ScalarImage(tensor=item["image"][..., None]))
    return {**item, "image": AUGMENT(subject)["image"].data[..., 0]}


def run(out: Path, pixels: int = 2048, images: int = 30) -> list[Path]:
    """Make a data set of crops with `pixels` / 16 pixels per side, train, and write the mean absolute errors of the
    validation images.
    """
    settings = DatasetSettings(images=images, matrix=pixels // 16, crop_mm=140, split=(0.7, 0.3, 0.0), seed=3)
    index = make_dataset(settings, out / "crops")
    training = KneeDataset(out / "crops", "train", transform=augment)
    validation = KneeDataset(out / "crops", "validation")
    torch.manual_seed(0)
    stages = [nn.Sequential(nn.LazyConv2d(16, 3, 2, 1), nn.LazyBatchNorm2d(), nn.ReLU()) for _ in range(4)]
    network = nn.Sequential(*stages, nn.AdaptiveAvgPool2d(4), nn.Flatten(), nn.LazyLinear(1))
    # The first batch determines the sizes of all layers.
    network(torch.stack([training[0]["image"], training[1]["image"]]))
    optimiser, history = torch.optim.AdamW(network.parameters(), lr=3e-3), []
    for epoch in range(EPOCHS):
        network.train()
        for batch in DataLoader(training, batch_size=4, shuffle=True, drop_last=True):
            loss = nn.functional.mse_loss(network(batch["image"])[:, 0], batch["jsw_medial_mm"])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        network.eval()
        with torch.no_grad():
            errors = [
                (network(batch["image"])[:, 0] - batch["jsw_medial_mm"]).abs()
                for batch in DataLoader(validation, batch_size=4)
            ]
        history.append(float(np.mean(torch.cat(errors).numpy())))
        print(f"epoch {epoch + 1}: mean error of the medial joint space {history[-1]:.2f} mm")
    path = out / "train_torchio.json"
    path.write_text(json.dumps({"mean_error_mm": history}) + "\n")
    return [index, path]


if __name__ == "__main__":
    run(Path("runs/examples"))
