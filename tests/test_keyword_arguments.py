"""Check keyword arguments: unknown names give the nearest valid name, earlier names a warning."""

import dataclasses
import pickle

import numpy as np
import pytest
import trimesh

import pssf
from pssf import InputError
from pssf.core.keyword_arguments import check_keywords


@pytest.mark.parametrize(
    ("call", "given", "nearest"),
    [
        (pssf.Knee, "jsw", "jsw_medial_mm"),
        (pssf.Knee, "osteophyte", "osteophytes"),
        (pssf.Osteophyte, "size", "size_mm"),
        (pssf.Cyst, "diameter", "diameter_mm"),
        (pssf.Surface, "in_side", "inside"),
        (pssf.Scene, "ambiant", "ambient"),
        (pssf.simulate, "worker", "workers"),
        (pssf.trace, "material", "materials"),
        (pssf.render_for_display, "bit", "bits"),
        (pssf.save, "intend", "intent"),
        (pssf.sample_acquisition, "sides", "side"),
        (pssf.build, "protocoll", "protocol"),
        (pssf.export_meshes, "format", "formats"),
    ],
)
def test_an_unknown_keyword_gives_an_error_with_the_nearest_name(call, given, nearest):
    with pytest.raises(InputError, match=rf"{call.__name__}: .*, got '{given}' \(did you mean '{nearest}'\?\)"):
        call(**{given: 1})


def test_changing_an_unknown_field_gives_the_nearest_name(small):
    with pytest.raises(InputError, match=r"Protocol: keywords must be among .*, got 'kv' \(did you mean 'tube_kv'\?\)"):
        dataclasses.replace(small, kv=80.0)
    with pytest.raises(InputError, match=r"did you mean 'jsw_medial_mm'"):
        pssf.sample_knee(grade=2, rng=1, jsw=3.0)


def test_a_former_argument_name_gives_a_warning_or_excludes_the_new_one():
    ball = trimesh.creation.icosphere(radius=20)
    scene = pssf.Scene([pssf.Surface(ball, inside="water", outside="air")])
    protocol = dataclasses.replace(pssf.load_protocol("reference"), rows=32, cols=32, pixel_mm=4.8, scatter="none")
    with pytest.warns(DeprecationWarning, match="simulate: seed is now rng"):
        earlier = pssf.simulate(scene, protocol, seed=3, engine="scanline")
    assert earlier == pssf.simulate(scene, protocol, rng=3, engine="scanline")
    with pytest.raises(InputError, match="got both rng and its former name seed; give only rng"):
        pssf.simulate(scene, protocol, seed=3, rng=3)


def test_the_seed_sampled_from_a_generator_reproduces_the_radiograph(small):
    scene = pssf.Scene([])
    first = pssf.simulate(scene, small, rng=np.random.default_rng(5))
    assert first == pssf.simulate(scene, small, rng=first.seed)
    assert first.seed != pssf.simulate(scene, small, rng=np.random.default_rng(6)).seed


def test_simulate_accepts_the_name_or_path_of_a_protocol(small, tmp_path):
    path = tmp_path / "own.toml"
    path.write_text('base = "reference"\nname = "own"\nrows = 16\ncols = 16\npixel_mm = 9.6\nscatter = "none"\n')
    radiograph = pssf.simulate(pssf.Scene([]), path)
    assert radiograph == pssf.simulate(pssf.Scene([]), pssf.load_protocol(path))
    with pytest.raises(InputError, match=r"protocol must be .*reference"):
        pssf.simulate(pssf.Scene([]), "referense")


def test_classes_with_checked_keywords_can_be_pickled_and_modified():
    knee = pssf.Knee(jsw_medial_mm=3.0)
    assert pickle.loads(pickle.dumps(knee)) == knee
    assert dataclasses.replace(knee, varus_deg=2.0).varus_deg == 2.0

    @check_keywords(before="now")
    def call(now=1, **others):
        return now, others

    assert call(any=2) == (1, {"any": 2})
    with pytest.warns(DeprecationWarning, match="before is now now"):
        assert call(before=3, any=2) == (3, {"any": 2})
