"""Check that built knees and scenes are unchanged by copying, pickling and sending to processes."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

import pssf
from pssf.anatomy import built_knee
from pssf.core.processes.parallel_map import map_in_parallel

TINY = {"rows": 64, "cols": 64, "pixel_mm": 4.8}


@pytest.fixture(scope="module")
def protocol():
    return dataclasses.replace(pssf.load_protocol("fixed_flexion"), **TINY)


@pytest.fixture(scope="module")
def left(protocol):
    """Build a left knee with cysts and an osteophyte in fixed flexion."""
    cysts = (pssf.Cyst(site="medial_tibia", diameter_mm=6.0),)
    osteophytes = (pssf.Osteophyte(site="medial_tibia", size_mm=2.5),)
    return pssf.build(pssf.Knee(side="left", jsw_medial_mm=2.0, cysts=cysts, osteophytes=osteophytes), protocol)


def simulate_outputs(subject, protocol):
    """Return pixels, masks and labels of a simulation."""
    radiograph = pssf.simulate(subject, protocol, engine="scanline", keep=("masks",), workers=1)
    truths = (radiograph.truth,) if radiograph.truths == () else radiograph.truths
    masks = [np.packbits(mask).tobytes() for truth in truths for mask in truth.masks.values()]
    return radiograph.pixels.tobytes(), masks, [dataclasses.replace(truth, masks={}) for truth in truths]


def test_a_pickled_knee_gives_the_same_radiograph(left, protocol):
    back = pickle.loads(pickle.dumps(left))
    assert back is not left
    assert back.assembly.posture == left.assembly.posture
    assert simulate_outputs(back, protocol) == simulate_outputs(left, protocol)
    for one, two in zip(left.scene.surfaces, back.scene.surfaces, strict=True):
        assert one.table() == two.table()


def test_a_pickled_knee_is_smaller_than_5000_bytes(left):
    assert len(pickle.dumps(left)) < 5000


def test_copying_a_built_knee_returns_the_same_object(left):
    assert copy.copy(left) is left
    assert copy.deepcopy({"knee": [left]})["knee"][0] is left


def test_a_built_knee_can_be_sent_to_worker_processes(left, protocol):
    expected = simulate_outputs(left, protocol)
    results = map_in_parallel(simulate_outputs, [left, left], shared={"protocol": protocol}, workers=2)
    assert results == [expected, expected]


def test_a_pickled_knee_preserves_a_modified_scene(left, protocol):
    """Check that a changed scene, for example with an implant, is not lost when the knee is rebuilt."""
    fewer = pssf.Scene(left.scene.surfaces[:3])
    back = pickle.loads(pickle.dumps(dataclasses.replace(left, scene=fewer)))
    again = pickle.loads(pickle.dumps(back))
    assert [surface.name for surface in again.scene.surfaces] == ["skin", "adipose", "muscle"]


def test_a_pickled_scene_with_trabeculae_gives_the_same_radiograph(left, protocol):
    before = pssf.simulate(left.scene, protocol, engine="scanline", workers=1)
    for back in (pickle.loads(pickle.dumps(left.scene)), copy.deepcopy(left.scene)):
        assert {type(surface.inside_density).__name__ for surface in back.surfaces} == {"NoneType", "Trabeculae"}
        after = pssf.simulate(back, protocol, engine="scanline", workers=1)
        assert after.pixels.tobytes() == before.pixels.tobytes()


def test_a_pickled_pair_of_knees_gives_the_same_radiograph():
    protocol = dataclasses.replace(pssf.load_protocol("bilateral"), rows=64, cols=128, pixel_mm=4.8)
    from pssf.anatomy import build_pair

    pair = build_pair(pssf.Knee(), pssf.Knee(side="left"), protocol)
    assert simulate_outputs(pickle.loads(pickle.dumps(pair)), protocol) == simulate_outputs(pair, protocol)


def test_an_osteophyte_inside_the_bone_has_an_empty_mask(left, protocol, monkeypatch):
    select = built_knee.select_osteophyte_faces
    none = pssf.geometry.mesh.Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))

    def select_with_empty(knee, assembly):
        return select(knee, assembly) | {"medial_spine": none}

    monkeypatch.setattr(built_knee, "select_osteophyte_faces", select_with_empty)
    masks = pssf.simulate(left, protocol, engine="scanline", keep=("masks",)).truth.masks
    assert not masks["medial_spine_osteophyte"].any()
    assert masks["medial_tibia_osteophyte"].any()
    assert masks["medial_spine_osteophyte"].shape == (64, 64)
