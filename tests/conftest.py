"""Shared fixtures: a knee built once, a small detector."""

import dataclasses
import json
import os

# There is a worker for every core: threads of BLAS would wait for each other, and take half of the suite's time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

import shutil
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import drawn
import pytest
from hypothesis import HealthCheck, settings

import pssf
from pssf import cohort, study
from pssf.cohort import cohort_maker
from pssf.data import code_hash
from pssf.study import StudyResult

# Hundreds of processes are started here, and each would compile all that it imports.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# No test is timed, and a commit that passes passes again: the examples are drawn from the test's own text.
settings.register_profile("pssf", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("pssf")


@pytest.fixture(scope="session")
def small() -> pssf.Protocol:
    """The reference protocol on 256 x 256 pixels of 1.2 mm: the same field."""
    return dataclasses.replace(pssf.load_protocol("reference"), rows=256, cols=256, pixel_mm=1.2)


@pytest.fixture(scope="session")
def knee() -> pssf.Knee:
    beaks = (pssf.Osteophyte(site="medial_tibia", size_mm=2.5), pssf.Osteophyte(site="lateral_femur", size_mm=1.0))
    return pssf.Knee(jsw_medial_mm=3.1, osteophytes=beaks, varus_deg=2.0, flexion_deg=3.0, rotation_deg=2.0, grade=2)


@pytest.fixture(scope="session")
def built(knee: pssf.Knee) -> pssf.BuiltKnee:
    return pssf.build(knee)


@pytest.fixture
def copied_code(tmp_path, monkeypatch) -> Iterator[Path]:
    """A copy of the package, which digests of code are taken of."""
    folder = tmp_path / "copied" / "pssf"
    shutil.copytree(code_hash.PACKAGE_ROOT, folder, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(code_hash, "PACKAGE_ROOT", folder)
    code_hash.compute_code_hashes.cache_clear()
    yield folder
    code_hash.compute_code_hashes.cache_clear()


def change(path: Path) -> None:
    """One byte more in a file of `copied_code`."""
    path.write_bytes(path.read_bytes() + b"\n")
    code_hash.compute_code_hashes.cache_clear()


@pytest.fixture(scope="session")
def scene(built: pssf.BuiltKnee) -> pssf.Scene:
    return built.scene


@pytest.fixture(scope="session")
def small_protocols(tmp_path_factory) -> list[str]:
    """Two protocols on tiny detectors, as files."""
    folder, paths = tmp_path_factory.mktemp("protocols"), []
    for name in ("reference", "low_dose"):
        protocol = dataclasses.replace(pssf.load_protocol(name), rows=64, cols=64, pixel_mm=4.8)
        fields = {k: v for k, v in dataclasses.asdict(protocol).items() if v is not None}
        path = folder / f"{name}.toml"
        path.write_text("".join(f"{k} = {json.dumps(v)}\n" for k, v in fields.items()))
        paths.append(str(path))
    return paths


@pytest.fixture(scope="session", autouse=True)
def built_once() -> Iterator[None]:
    """Cohorts of this process build a knee once, however often they make it; other processes build their own."""
    with pytest.MonkeyPatch.context() as patch:
        built = lru_cache(maxsize=8)(cohort_maker.build)
        patch.setattr(cohort_maker, "build", built)
        yield
        built.cache_clear()


@pytest.fixture(scope="session")
def whole_cohort(small_protocols, tmp_path_factory) -> Path:
    """The folder of a cohort of three knees, made by one worker; to be looked at only."""
    folder = tmp_path_factory.mktemp("whole") / "c"
    plan = cohort.plan_cohort("quick", seed=5, overrides={"knees": [1, 1, 1], "protocols": small_protocols})
    cohort.make_cohort(plan, folder, workers=1)
    return folder


@pytest.fixture(scope="session")
def film_study(tmp_path_factory) -> StudyResult:
    """A study of drawn knees whose subjects are texts, tested on drawn films; to be looked at only.

    Its films are of grades 0, 1, 2 and 3; some inverted, one cut too narrow, one without a knee, one damaged.
    """
    folder = tmp_path_factory.mktemp("film_study")
    return study.run(
        drawn.text_subjects(), drawn.cohort().load, [drawn.TEMPLATE], drawn.LIGHT, folder / "out",
        films=drawn.film_set(drawn.films(folder / "films")),
    )  # fmt: skip
