"""Shared fixtures: a knee built once, a small detector."""

import dataclasses

import pytest

import pssf


@pytest.fixture(scope="session")
def small() -> pssf.Protocol:
    """The reference protocol on 256 x 256 pixels of 1.2 mm: the same field."""
    return dataclasses.replace(pssf.load_protocol("reference"), rows=256, cols=256, pixel_mm=1.2)


@pytest.fixture(scope="session")
def knee() -> pssf.Knee:
    beaks = (pssf.Osteophyte(site="medial_tibia", size_mm=2.5), pssf.Osteophyte(site="lateral_femur", size_mm=1.0))
    return pssf.Knee(jsw_medial_mm=3.1, osteophytes=beaks, varus_deg=2.0, flexion_deg=3.0, rotation_deg=2.0, grade=2)


@pytest.fixture(scope="session")
def scene(knee: pssf.Knee) -> pssf.Scene:
    return pssf.build(knee)
