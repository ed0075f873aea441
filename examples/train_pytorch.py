"""Train a small network of plain PyTorch to find femur, tibia, patella and joint space, with images from a folder."""

from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.utils.data import DataLoader

from pssf.dataset import DatasetSettings, make_dataset
from pssf.io.pictures import make_panel, write_image_row
from pssf.torch import KneeDataset

EPOCHS = 3


def make_network(kinds: int) -> nn.Module:
    """Make a network of dilated convolutions with one output channel per kind of part."""
    layers, channels = [], 1
    for dilation in (1, 2, 4, 8, 4, 2):
        convolution = nn.Conv2d(channels, 24, 3, padding=dilation, dilation=dilation, padding_mode="replicate")
        layers += [convolution, nn.BatchNorm2d(24), nn.ReLU()]
        channels = 24
    return nn.Sequential(*layers, nn.Conv2d(channels, kinds, 1))


def compute_dice(predicted: torch.Tensor, true: torch.Tensor, value: int) -> float:
    """Compute the Dice coefficient of one kind of part."""
    found, there = predicted == value, true == value
    return float(2 * (found & there).sum() / (found.sum() + there.sum()).clamp(min=1))


def run(out: Path, pixels: int = 2048, images: int = 30) -> list[Path]:
    """Make a data set of `images` images with `pixels` / 8 pixels per side, train, and draw one validation image."""
    settings = DatasetSettings(images=images, matrix=pixels // 8, split=(0.7, 0.3, 0.0), seed=1)
    index = make_dataset(settings, out / "dataset")
    training, validation = (KneeDataset(out / "dataset", split) for split in ("train", "validation"))
    torch.manual_seed(0)
    network = make_network(max(training.label_map.values()) + 1)
    optimiser = torch.optim.AdamW(network.parameters(), lr=3e-3)
    for epoch in range(EPOCHS):
        network.train()
        losses = []
        for batch in DataLoader(training, batch_size=2, shuffle=True):
            loss = nn.functional.cross_entropy(network(batch["image"]), batch["label_map"])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(float(loss.detach()))
        network.eval()
        dice = {"femur": [], "tibia": []}
        for batch in DataLoader(validation, batch_size=2):
            with torch.no_grad():
                predicted = network(batch["image"]).argmax(dim=1)
            for kind, values in dice.items():
                values.append(compute_dice(predicted, batch["label_map"], training.label_map[kind]))
        means = ", ".join(f"Dice of {kind} {np.mean(values):.2f}" for kind, values in dice.items())
        print(f"epoch {epoch + 1}: loss {np.mean(losses):.2f}, {means}")
    item = validation[0]
    with torch.no_grad():
        predicted = network(item["image"][None]).argmax(dim=1)[0]
    # 25 grey levels per kind of part show the label maps.
    shown = [item["image"][0] * 255, item["label_map"] * 25, predicted * 25]
    captions = ("validation image", "label map", f"found after {EPOCHS} epochs")
    panels = [
        make_panel(picture.numpy().astype(np.uint8), 400, 340, caption)
        for picture, caption in zip(shown, captions, strict=True)
    ]
    return [index, write_image_row(panels, out / "train_pytorch.png")]


if __name__ == "__main__":
    run(Path("runs/examples"))
