"""Command that simulates the response of each scintillator of the package and stores it in the package.

Run ``python -m tools.export_scintillators`` in the folder ``tests`` after a change of a scintillator, of
`xray.scintillator_response` or of the modules that it uses.
"""

from pssf.data.array_cache import save_to_package
from pssf.model.detector import load_detectors
from pssf.xray.response_of_mass import make_node_detectors
from pssf.xray.scintillator_response import response_name, response_origin, simulate_response_arrays


def main() -> None:
    """Replace the responses of all detectors, and of the layers between which responses are interpolated."""
    known = [load_detectors()[name] for name in ("csi", "gos")]
    for detector in (*known, *(node for each in known for node in make_node_detectors(each))):
        save_to_package(response_name(detector), response_origin(detector), simulate_response_arrays(detector))


if __name__ == "__main__":
    main()
