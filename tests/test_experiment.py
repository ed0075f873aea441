"""From a plan to what the study is given."""

import dataclasses
import json
from contextlib import contextmanager

import pandas as pd

import pssf
from pssf import cohort
from pssf.experiment import _below, _pixels, _taken_again
from pssf.progress import Pace

HOW = {"workers": 1, "scheduler": None, "engine": "scanline"}


@contextmanager
def bar(what, total):
    yield Pace(total)


def test_knees_taken_again_are_told_by_knee_kind_and_turn_and_their_files_are_found(tmp_path):
    protocol = dataclasses.replace(pssf.load_protocol("reference"), rows=64, cols=64, pixel_mm=4.8)
    fields = {name: value for name, value in dataclasses.asdict(protocol).items() if value is not None}
    path = tmp_path / "reference.toml"
    path.write_text("".join(f"{name} = {json.dumps(value)}\n" for name, value in fields.items()))
    wanted = {"knees": [0, 1, 1], "protocols": [str(path)], "retested": 1}
    plan = cohort.plan_cohort("quick", seed=1, overrides=wanted)
    again = _taken_again(plan, tmp_path, bar, HOW)
    assert list(again["kind"]) == ["noise", "noise", "perturbation", "perturbation"]
    assert list(again["turn"]) == ["1", "2", "1", "2"]
    assert (again["knee"] == plan.cases[0].index).all()
    assert (again["subject"] == plan.cases[0].subject).all()
    for file in again["file"]:
        assert _pixels(tmp_path, file).shape == (64, 64)
    assert _taken_again(dataclasses.replace(plan, retested=0), tmp_path, bar, HOW) is None


def test_files_are_named_from_the_folder_above():
    assert list(_below("cohort", pd.DataFrame({"file": ["images/a.tif"]}))["file"]) == ["cohort/images/a.tif"]
