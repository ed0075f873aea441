"""Evaluation of simulated images by the CTSimU test suite for radiographic simulators (BAM).

The scenes follow the published scenario files of the suite; the suite's own program reads the images. The module needs
the package ``ctsimu`` from the dependency group ``peers``.
"""

import importlib
import io
import tempfile
import warnings
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh
from scipy.optimize import brentq

from ...core.checks import Array, InputError
from ...data.imaging.ctsimu_table import CtsimuTable, load_ctsimu
from ...geometry.scene import Scene, Surface
from ...geometry.view import SIGMA_PER_FWHM
from ...image_faults import ImageNotice
from ...model.detector import load_detectors
from ...model.protocol import Protocol, load_protocol
from ...simulation import simulate
from ...xray.materials import attenuation_per_mm, parse_compound
from ...xray.primary_beam import transmit
from ...xray.resolved_technique import resolve_technique
from ...xray.spectrum import compute_beam

Row = dict[str, Any]
# Name of the table.
_TABLE = "ctsimu_images"
# Grey value of the free beam.
_FREE_BEAM = 60000.0
# Rotation of edge and wires, in degrees.
_TILT_DEG = 3.0
# Diameters of the wire pairs, which are also their gaps (ISO 19232-5), in mm, and length of the wires, in mm.
_WIRES_MM = (0.8, 0.63, 0.5, 0.4, 0.32, 0.25, 0.2, 0.16, 0.13, 0.1, 0.08, 0.063, 0.05)
_WIRE_LENGTH_MM = 15.0
# Distance between neighbouring wire pairs, in mm.
_PAIR_DISTANCE_MM = 2.0
# Platinum of the wires, and the density of an edge that transmits nothing, in g/cm3.
_PLATINUM, _OPAQUE = "Pt@21.45", "W@25"
# Modulation depth that defines the basic spatial resolution (ASTM E2002).
_DEPTH = 0.2
# Largest spatial frequency of the tabulated MTF, in 1/mm.
_MTF_PER_MM = 40.0
# Expected standard deviations of the line spread function for focal spots of 8 and 24 um, in um (suite, 2D-WE-1).
_EXPECTED_LSF_UM = {"spot1": 9.579, "spot2": 24.552}


def compare_images_with_ctsimu() -> list[Row]:
    """Simulate images of the CTSimU suite, and let the suite's program evaluate them.

    Returns
    -------
    list of dict
        One row per test and number of rays: ``quantity``, the value ``measured`` by the suite's program, the
        ``expected`` value, and ``unit``.

    Raises
    ------
    InputError
        The package ``ctsimu`` is not installed.
    """
    try:
        importlib.import_module("ctsimu")
    except ImportError:
        raise InputError(f"table {_TABLE} needs the package ctsimu: run uv sync --group peers") from None
    tube = load_ctsimu()
    rows: list[Row] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ImageNotice)
        for measure in (_measure_flat_field, _measure_noise, _measure_edge, _measure_focal_spot, _measure_wires):
            rows += measure(tube)
    return rows


def _make_protocol(tube: CtsimuTable, **fields: Any) -> Protocol:
    """Make a protocol with an ideal detector, a point source, no noise and no scatter."""
    plain = replace(
        load_protocol("reference"),
        detector=load_detectors()["ideal"],
        filtration_mm_al=tube.window_mm_al,
        anode_angle_deg=tube.anode_angle_deg,
        focal_spot_mm=0.0,
        scatter="none",
        noise="none",
        detector_blur="none",
        marker="none",
    )
    return replace(plain, **fields)


def _simulate_grey(scene: Scene, protocol: Protocol) -> Array:
    """Simulate an image without noise (rows, cols), as grey values that are 60000 in the free beam."""
    exposed = _set_free_beam(protocol)
    image, flat = (simulate(one, exposed, rng=0, engine="scanline").pixels.astype(float) for one in (scene, Scene([])))
    return _FREE_BEAM * image / flat


def _set_free_beam(protocol: Protocol) -> Protocol:
    """Set the gain of the detector so that the free beam has a grey value of 60000 on the central ray."""
    technique = resolve_technique(replace(protocol, rows=1, cols=1))
    kev = float(transmit({}, compute_beam(technique), technique).kev[0, 0])
    electrons = kev * technique.detector.electrons_per_kev
    gain = electrons / protocol.pixel_mm**2 / _FREE_BEAM
    return replace(protocol, detector=replace(technique.detector, electrons_per_dn_mm2=gain, offset_dn=0.0))


class _SuiteTest:
    """Test of the suite that evaluates images one after the other, and its program's folder of results."""

    def __init__(self, module: str, subtests: Sequence[str] = ()) -> None:
        self._folder = tempfile.TemporaryDirectory()
        suite = importlib.import_module(f"ctsimu.evaluation.test{module}")
        pipeline = importlib.import_module("ctsimu.processing.pipeline").Pipeline()
        self.test = getattr(suite, f"Test{module}")(resultFileDirectory=self._folder.name, name=module)
        self.test.setPipeline(pipeline)
        for name in subtests:
            self.test.addSubtest(name)

    def evaluate(self, grey: Array) -> Any:
        """Evaluate an image.

        Parameters
        ----------
        grey : (rows, cols) array, grey values
            Image, 60000 in the free beam.

        Returns
        -------
        object
            The test of the suite with its results.
        """
        image = importlib.import_module("ctsimu.image").Image()
        image.setPixelMap(np.asarray(grey, np.float64))
        image.setHeight(grey.shape[0])
        image.setWidth(grey.shape[1])
        with redirect_stdout(io.StringIO()):
            self.test.run(image)
        return self.test


def _measure_flat_field(tube: CtsimuTable) -> list[Row]:
    """Compare a flat field with the law of distance and incidence (2D-FB-2), enlarged ten times."""
    protocol = _make_protocol(tube, rows=501, cols=501, pixel_mm=4.0, sdd_mm=300.0, sod_mm=50.0, tube_kv=150.0)
    kev = simulate(Scene([]), protocol, rng=0, keep=("primary",), engine="scanline").kept["primary"][250].astype(float)
    place = 4.0 * (np.arange(501) - 250)
    expected = (1 + (place / 300.0) ** 2) ** -1.5
    worst = float(np.abs(kev / kev[250] / expected - 1).max())
    return [_row("2D-FB-2", "largest deviation from cos(a) / r^2, up to 73 degrees", 100 * worst, 0.0, "%")]


def _measure_noise(tube: CtsimuTable) -> list[Row]:
    """Compare the signal-to-noise ratio of a flat field with its nominal value (2D-FB-1)."""
    rows = []
    for nominal in (100.0, 250.0):
        protocol = _make_protocol(
            tube,
            rows=1000,
            cols=1000,
            pixel_mm=0.1,
            sdd_mm=2000.0,
            sod_mm=1800.0,
            tube_kv=150.0,
            mas=1.0,
            noise="quantum",
        )
        beam = compute_beam(resolve_technique(protocol))
        signal, square = (beam.photons_per_mm2 @ each for each in (beam.signal_kev, beam.square_kev2))
        per_mas = signal**2 / square * (0.1 * 1000.0 / protocol.sdd_mm) ** 2
        exposed = _set_free_beam(replace(protocol, mas=float(nominal**2 / per_mas)))
        images = (exposed, replace(exposed, noise="none"))
        noisy, flat = (simulate(Scene([]), one, rng=1, engine="scanline").pixels for one in images)
        corrected = noisy / flat.astype(float)
        rows.append(_row("2D-FB-1", "signal-to-noise ratio", corrected.mean() / corrected.std(), nominal, ""))
    return rows


def _measure_edge(tube: CtsimuTable) -> list[Row]:
    """Compare pixels that a tilted edge covers partly with their covered area (2D-WE-2)."""
    rows, suite = [], _SuiteTest("2D_WE_2")
    for subpixels in (1, 3, 5):
        protocol = _make_edge_protocol(tube, tube_kv=50.0, subpixels=subpixels)
        test = suite.evaluate(_simulate_grey(_make_edge(), protocol))
        rays = _name_rays(subpixels)
        matched, rms = 100 * test.matchRatio, 100 * test.partlyCovered_rmsd / _FREE_BEAM
        rows.append(_row("2D-WE-2", f"pixels partly covered in both images, {rays}", matched, 100.0, "%"))
        rows.append(_row("2D-WE-2", f"RMS difference of these pixels, {rays}", rms, 0.0, "%"))
    return rows


def _measure_focal_spot(tube: CtsimuTable) -> list[Row]:
    """Compare the blur of an edge by a Gaussian focal spot with its expected value (2D-WE-1)."""
    rows, suite = [], _SuiteTest("2D_WE_1", list(_EXPECTED_LSF_UM))
    for run, (name, sigma_mm) in enumerate((("spot1", 0.008), ("spot2", 0.024))):
        protocol = _make_edge_protocol(
            tube, tube_kv=150.0, subpixels=5, focal_spot_mm=sigma_mm / SIGMA_PER_FWHM, focal_spot_shape="gaussian"
        )
        result = suite.evaluate(_simulate_grey(_make_edge(), protocol)).results[run]
        measured = 1000 * result.measuredGaussianSigmaPX * result.pixelSize
        label = f"width of the line spread function, focal spot {1000 * sigma_mm:.0f} um"
        rows.append(_row("2D-WE-1", label, measured, _EXPECTED_LSF_UM[name], "um"))
    return rows


def _make_edge_protocol(tube: CtsimuTable, **fields: Any) -> Protocol:
    """Make the protocol of the tests with an edge."""
    return _make_protocol(tube, rows=1001, cols=1001, pixel_mm=0.008, sdd_mm=1000.0, sod_mm=500.0, **fields)


def _make_edge() -> Scene:
    """Make an opaque plate whose upper right corner is on the central ray, tilted by 3 degrees."""
    mesh = trimesh.creation.box((5.0, 5.0, 5.0)).apply_translation((-2.5, 2.5, -2.5))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(_TILT_DEG), (0, 1, 0)))
    return Scene([Surface(mesh, _OPAQUE, "air", "edge")])


def _measure_wires(tube: CtsimuTable) -> list[Row]:
    """Compare the basic spatial resolution, read from wire pairs, with its nominal value (2D-DW-1)."""
    rows = []
    for name, nominal_mm in (("SR75", 0.075), ("SR150", 0.15)):
        for subpixels in (1, 5):
            protocol = _make_wire_protocol(tube, subpixels=subpixels)
            frequency = np.linspace(0.0, _MTF_PER_MM, 401)
            sigma = find_blur_of_resolution(nominal_mm, protocol)
            mtf = np.exp(-2 * (np.pi * frequency * sigma) ** 2)
            table = tuple(zip(frequency.tolist(), mtf.tolist(), strict=True))
            detector = replace(load_detectors()["ideal"], mtf=table)
            blurred = replace(protocol, detector=detector, detector_blur="mtf")
            test = _SuiteTest("2D_DW_1", [name]).evaluate(_simulate_grey(_make_wires(), blurred))
            label = f"basic spatial resolution, {_name_rays(subpixels)}"
            rows.append(_row("2D-DW-1", label, 1000 * test.results[0].SRb_interpolated, 1000 * nominal_mm, "um"))
    return rows


def _make_wire_protocol(tube: CtsimuTable, **fields: Any) -> Protocol:
    """Make the protocol of the test with wire pairs."""
    return _make_protocol(
        tube, rows=1000, cols=2000, pixel_mm=0.05, sdd_mm=1000.0, sod_mm=998.6, tube_kv=220.0,
        filters=(("Cu@8.96", 2.0),), **fields,
    )  # fmt: skip


def _make_wires() -> Scene:
    """Make the pairs of platinum wires, from thick to thin, tilted by 3 degrees."""
    surfaces, x = [], -20.0
    tilt = trimesh.transformations.rotation_matrix(np.deg2rad(_TILT_DEG), (0, 1, 0))
    for pair, mm in enumerate(_WIRES_MM):
        for wire in range(2):
            mesh = trimesh.creation.cylinder(mm / 2, _WIRE_LENGTH_MM, sections=64)
            mesh.apply_translation((x + mm / 2 + 2 * mm * wire, 0, 0)).apply_transform(tilt)
            surfaces.append(Surface(mesh, _PLATINUM, "air", f"wire_{pair}_{wire}"))
        x += 3 * mm + _PAIR_DISTANCE_MM
    return Scene(surfaces)


def find_blur_of_resolution(resolution_mm: float, protocol: Protocol) -> float:
    """Compute the Gaussian blur at which a wire pair has a modulation depth of 20 %.

    Parameters
    ----------
    resolution_mm : float
        Diameter and gap of the wires, in mm.
    protocol : Protocol
        Protocol with the beam.

    Returns
    -------
    float
        Standard deviation of the blur, in mm.
    """
    wire = parse_compound(_PLATINUM)
    beam = compute_beam(resolve_technique(protocol), [wire])
    weights = beam.photons_per_mm2 * beam.signal_kev
    x = np.linspace(-6 * resolution_mm, 6 * resolution_mm, 2401)
    chord = sum(
        2 * np.sqrt(np.maximum((resolution_mm / 2) ** 2 - (x - side * resolution_mm) ** 2, 0.0)) for side in (-1, 1)
    )
    signal = 1 - np.exp(-np.outer(chord, attenuation_per_mm(wire, beam.energies_kev))) @ weights / weights.sum()

    def blurred(at_mm: float, sigma: float) -> float:
        kernel = np.exp(-0.5 * ((x - at_mm) / sigma) ** 2)
        return float(signal @ kernel / kernel.sum())

    def depth(sigma: float) -> float:
        places = np.linspace(0.5 * resolution_mm, 1.5 * resolution_mm, 101)
        dip = max(blurred(place, sigma) for place in places)
        return (dip - blurred(0.0, sigma)) / dip - _DEPTH

    return float(brentq(depth, 0.2 * resolution_mm, 1.5 * resolution_mm))


def _name_rays(subpixels: int) -> str:
    """Name the number of rays per pixel."""
    return f"{subpixels**2} rays" if subpixels > 1 else "1 ray"


def _row(test: str, quantity: str, measured: float, expected: float, unit: str) -> Row:
    """Make a table row."""
    return {"test": test, "quantity": quantity, "measured": float(measured), "expected": expected, "unit": unit}
