"""Fixtures for all tests, such as a knee that is built once and a protocol with a small detector."""

import dataclasses
import json
import os

# Each core runs one test worker; BLAS threads would compete for the cores and double the suite's run time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import block_knee_cohort
import pytest
from hypothesis import HealthCheck, settings

import pssf
from pssf import cohort, simulation, study
from pssf.anatomy import knee_pair
from pssf.cohort import cohort_maker
from pssf.core.processes.worker_processes import limit_manifold_to_one_thread
from pssf.data import code_hash
from pssf.dataset import sample
from pssf.model.protocol import Posture
from pssf.study import StudyResult

# The suite starts hundreds of processes; without bytecode files each would compile every module that it imports.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

if "PYTEST_XDIST_WORKER" in os.environ:
    # Building knees then takes 11 % less CPU time, because threads of manifold3d do not compete for the cores.
    limit_manifold_to_one_thread()

# No test has a deadline. Hypothesis derives its examples from the test's source, so that results are reproducible.
settings.register_profile("pssf", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("pssf")


@pytest.fixture(scope="session")
def small() -> pssf.Protocol:
    """Return the reference protocol with 256 x 256 pixels of 1.2 mm and an unchanged field of view."""
    return dataclasses.replace(pssf.load_protocol("reference"), rows=256, cols=256, pixel_mm=1.2)


@pytest.fixture(scope="session")
def knee() -> pssf.Knee:
    osteophytes = (
        pssf.Osteophyte(site="medial_tibia", size_mm=2.5),
        pssf.Osteophyte(site="lateral_femur", size_mm=1.0),
    )
    return pssf.Knee(
        jsw_medial_mm=3.1, osteophytes=osteophytes, varus_deg=2.0, flexion_deg=3.0, rotation_deg=2.0, grade=2
    )


@pytest.fixture(scope="session")
def built(knee: pssf.Knee) -> pssf.BuiltKnee:
    return build_once(knee)


@pytest.fixture
def copied_code(tmp_path, monkeypatch) -> Iterator[Path]:
    """Copy the package and compute code hashes from the copy."""
    folder = tmp_path / "copied" / "pssf"
    shutil.copytree(code_hash.PACKAGE_ROOT, folder, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(code_hash, "PACKAGE_ROOT", folder)
    code_hash.compute_code_hashes.cache_clear()
    yield folder
    code_hash.compute_code_hashes.cache_clear()


def append_byte(path: Path) -> None:
    """Append one byte to a file of `copied_code`."""
    path.write_bytes(path.read_bytes() + b"\n")
    code_hash.compute_code_hashes.cache_clear()


@pytest.fixture(scope="session")
def scene(built: pssf.BuiltKnee) -> pssf.Scene:
    return built.scene


@pytest.fixture(scope="session")
def small_protocols(tmp_path_factory) -> list[str]:
    """Write two protocols with tiny detectors and return their paths."""
    folder = tmp_path_factory.mktemp("protocols")
    return [write_small_protocol(folder, name) for name in ("reference", "low_dose")]


def write_small_protocol(folder: Path, name: str) -> str:
    """Write a protocol with 64 x 64 pixels of 4.8 mm and return its path."""
    return write_protocol(folder, dataclasses.replace(pssf.load_protocol(name), rows=64, cols=64, pixel_mm=4.8))


def write_protocol(folder: Path, protocol: pssf.Protocol) -> str:
    """Write a protocol as a file with its name and return the path."""
    fields = {k: v for k, v in dataclasses.asdict(protocol).items() if v is not None}
    path = folder / f"{protocol.name}.toml"
    path.write_text("".join(f"{k} = {json.dumps(v)}\n" for k, v in fields.items()))
    return str(path)


_MOST_BUILT_KNEES = 12
_built_knees: dict[tuple[pssf.Knee, Posture], pssf.BuiltKnee] = {}


def build_once(knee: pssf.Knee, protocol: pssf.Protocol | None = None) -> pssf.BuiltKnee:
    """Build a knee as `pssf.build` does, or return the same immutable knee that an earlier test built."""
    key = knee, Posture() if protocol is None else protocol.posture
    _built_knees[key] = _built_knees.pop(key, None) or pssf.build(knee, protocol)
    if len(_built_knees) > _MOST_BUILT_KNEES:
        del _built_knees[next(iter(_built_knees))]
    return _built_knees[key]


def forget_built_knees() -> None:
    """Clear the cache of built knees, for tests of reproducibility."""
    _built_knees.clear()


@pytest.fixture(scope="session", autouse=True)
def built_once() -> Iterator[None]:
    """Cache the knees that are built in the test process; worker processes have no such cache."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (simulation, cohort_maker, knee_pair, sample):
            patch.setattr(module, "build", build_once)
        yield
        forget_built_knees()


@pytest.fixture(scope="session")
def whole_cohort(small_protocols, tmp_path_factory) -> Path:
    """Make a cohort of three knees with one worker and return its folder; tests must not change it."""
    folder = tmp_path_factory.mktemp("whole") / "c"
    plan = cohort.plan_cohort("quick", seed=5, overrides={"knees": [1, 1, 1], "protocols": small_protocols})
    cohort.make_cohort(plan, folder, workers=1)
    return folder


@pytest.fixture(scope="session")
def film_study(tmp_path_factory) -> StudyResult:
    """Run a study of block knees whose subjects are texts and test it on block radiographs; tests must not change it.

    The radiographs have grades 0 to 3; some are inverted, one is too narrow, one has no knee, one is damaged.
    """
    folder = tmp_path_factory.mktemp("film_study")
    return study.run(
        block_knee_cohort.select_text_subjects(),
        block_knee_cohort.make_cohort().load,
        [block_knee_cohort.TEMPLATE],
        block_knee_cohort.LIGHT,
        folder / "out",
        films=block_knee_cohort.make_film_set(block_knee_cohort.write_films(folder / "films")),
    )
