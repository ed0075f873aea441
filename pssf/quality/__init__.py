"""quality.measure_quality  protocol -> a table of its figures beside references, and the curves behind them
quality.write_quality    what was measured -> CSV, and a figure (extra "study")

beam      half-value layers, kerma, photons     detector  MTF, NPS, DQE, photon transfer
exposure  exposure index, scatter, noise        measure   all of these beside references
figure    the curves, drawn                     write     tables and figure
"""

from .measure import Quality, measure_quality
from .write import write_quality

__all__ = ["Quality", "measure_quality", "write_quality"]
