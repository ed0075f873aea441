"""Train a small network of plain PyTorch to segment a knee, with images from a folder."""

import json
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.utils.data import DataLoader

from pssf.dataset import DatasetSettings, make_dataset
from pssf.torch import KneeDataset

EPOCHS = 3


def make_network(kinds: int) -> nn.Module:
    """Make a network of dilated convolutions with one output channel per class."""
    layers, channels = [], 1
    for dilation in (1, 2, 4, 8, 4, 2):
        layers += [nn.Conv2d(channels, 24, 3, padding=dilation, dilation=dilation), nn.GroupNorm(4, 24), nn.ReLU()]
        channels = 24
    return nn.Sequential(*layers, nn.Conv2d(channels, kinds, 1))


def run(out: Path, pixels: int = 2048, images: int = 30) -> list[Path]:
    """Make a data set of `images` images with `pixels` / 8 pixels per side, train, and write the losses."""
    settings = DatasetSettings(images=images, matrix=pixels // 8, split=(0.7, 0.3, 0.0), seed=1)
    index = make_dataset(settings, out / "dataset")
    training, validation = (KneeDataset(out / "dataset", split) for split in ("train", "validation"))
    torch.manual_seed(0)
    network = make_network(max(training.label_map.values()) + 1)
    optimiser = torch.optim.AdamW(network.parameters(), lr=3e-3)

    def compute_loss(batch: dict[str, torch.Tensor]) -> torch.Tensor:
        return nn.functional.cross_entropy(network(batch["image"]), batch["label_map"])

    history = []
    for epoch in range(EPOCHS):
        losses = []
        for batch in DataLoader(training, batch_size=2, shuffle=True):
            loss = compute_loss(batch)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(float(loss.detach()))
        with torch.no_grad():
            checked = [float(compute_loss(batch)) for batch in DataLoader(validation, batch_size=2)]
        history.append({"training": float(np.mean(losses)), "validation": float(np.mean(checked))})
        print(f"epoch {epoch + 1}:", ", ".join(f"{name} loss {value:.2f}" for name, value in history[-1].items()))
    path = out / "train_pytorch.json"
    path.write_text(json.dumps(history) + "\n")
    return [index, path]


if __name__ == "__main__":
    run(Path("runs/examples"))
