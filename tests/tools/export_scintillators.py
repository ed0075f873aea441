"""Command that simulates the response of each scintillator of the package and stores it in the package.

Run ``python -m tools.export_scintillators`` in the folder ``tests`` after a change of a scintillator, of
`xray.scintillator_response` or of the modules that it uses.
"""

from pssf.data.array_cache import save_to_package
from pssf.model.detector import load_detectors
from pssf.xray.scintillator_response import response_name, response_origin, simulate_response_arrays


def main() -> None:
    """Simulate the responses of all detectors, and replace their files in the package."""
    for detector in (load_detectors()[name] for name in ("csi", "gos")):
        save_to_package(response_name(detector), response_origin(detector), simulate_response_arrays(detector))


if __name__ == "__main__":
    main()
