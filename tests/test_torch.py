"""Data sets of PyTorch: items agree with the files, and streams are reproducible."""

import importlib
import json
import sys

import numpy as np
import pytest

import pssf
from pssf.dataset import DatasetSettings, make_dataset

pytest.importorskip("torch", reason="PyTorch (`torch` extra) is not installed")

import torch
from torch.utils.data import DataLoader

from pssf.torch import KneeDataset, KneeStream

SETTINGS = DatasetSettings(
    images=4,
    matrix=64,
    seed=5,
    randomise=("affine",),
    split=(0.5, 0.5, 0.0),
    maps=("cortical_bone",),
    protocols=("fixed_flexion", "lateral"),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of a data set with two views."""
    out = tmp_path_factory.mktemp("set")
    make_dataset(SETTINGS, out, workers=1)
    return out


def test_items_agree_with_the_files_of_the_data_set(folder):
    data = KneeDataset(folder, image="linear", keep=("masks", "maps"))
    assert len(data) == 2
    for index, item in enumerate(data):
        labels = json.loads((folder / "train/labels" / f"{data.names[index]}.json").read_text())
        assert data.read_labels(index) == labels
        assert (item["name"], int(item["kl"])) == (labels["name"], labels["kl"])
        rows, cols = labels["rows"], labels["cols"]
        assert item["image"].shape == (1, rows, cols)
        assert item["maps"].shape == (1, rows, cols)
        assert 0 < float(item["image"].min()) < float(item["image"].max()) < 1
        for name, place in zip(data.landmark_names, item["landmarks_px"], strict=True):
            if name in labels["landmarks_px"]:
                assert place.tolist() == pytest.approx(labels["landmarks_px"][name], abs=1e-4)
            else:
                assert torch.isnan(place).all()
        assert bool(torch.isnan(item["jsw_medial_mm"])) == (labels["jsw_medial_mm"] is None)
        femur = item["masks"][list(data.label_map).index("femur") - 1]
        assert int(femur.sum()) == next(one["area"] for one in labels["instances"] if one["name"] == "femur")
        # Every labelled pixel belongs to a mask of its kind.
        for value in np.unique(item["label_map"]):
            if value:
                assert item["masks"][value - 1][item["label_map"] == value].all()


def test_a_stream_simulates_the_images_of_a_data_set_and_new_subjects_in_every_epoch(folder):
    stored = {name: KneeDataset(folder, split) for split in ("train", "validation") for name in [split]}
    stored = {item["name"]: item for data in stored.values() for item in data}
    stream = KneeStream(SETTINGS)
    first, second = ({item["name"]: item for item in stream} for _ in range(2))
    assert stream.landmark_names == KneeDataset(folder).landmark_names
    assert first.keys() == stored.keys()
    assert not first.keys() & second.keys()
    for name, item in first.items():
        assert torch.equal(item["image"], stored[name]["image"])
        assert torch.equal(item["label_map"], stored[name]["label_map"])
        assert int(item["kl"]) == int(stored[name]["kl"])
    stream.set_epoch(1)
    loader = DataLoader(stream, batch_size=None, num_workers=2)
    assert {item["name"] for item in loader} == second.keys()
    # Each loader process counts its epochs.
    assert not {item["name"] for item in loader} & (first.keys() | second.keys())


def test_transforms_change_items(folder):
    data = KneeDataset(folder, "validation", transform=lambda item: {"kl": item["kl"] + 10})
    assert [int(item["kl"]) for item in data] == [kl + 10 for kl in data.kl]


def test_unsuitable_folders_and_parts_are_refused(folder, tmp_path):
    with pytest.raises(pssf.InputError, match=r"keep must be one of masks, maps, got 'depth'"):
        KneeDataset(folder, keep=("depth",))
    with pytest.raises(pssf.InputError, match=r"image must be one of linear, display"):
        KneeDataset(folder, image="png")
    with pytest.raises(pssf.InputError, match=r"folder must contain a data set made by pssf dataset"):
        KneeDataset(tmp_path)
    with pytest.raises(pssf.InputError, match=r"split must be a subset with images, got 'test'"):
        KneeDataset(folder, "test")
    with pytest.raises(pssf.InputError, match=r"epoch must be"):
        KneeStream(DatasetSettings(matrix=32)).set_epoch(-1)
    with pytest.raises(pssf.InputError, match=r"keep must not contain maps"):
        KneeStream(DatasetSettings(matrix=32), keep=("maps",))
    make_dataset(DatasetSettings(images=1, matrix=32, layout="shards"), tmp_path, workers=1)
    with pytest.raises(pssf.InputError, match=r"layout must be folder, got layout = shards"):
        KneeDataset(tmp_path)


def test_a_damaged_image_is_refused_with_its_name(folder, tmp_path):
    make_dataset(DatasetSettings(images=1, matrix=32, split=(1.0, 0.0, 0.0)), tmp_path, workers=1)
    path = next((tmp_path / "train/display").iterdir())
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(pssf.InputError, match=path.name):
        KneeDataset(tmp_path)[0]
    path.unlink()
    with pytest.raises(pssf.InputError, match=path.name):
        KneeDataset(tmp_path)[0]


def test_a_missing_pytorch_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "pssf.torch")
    with pytest.raises(ImportError, match=r"pssf\.torch needs PyTorch: pip install 'pssf\[torch\]'"):
        importlib.import_module("pssf.torch")
