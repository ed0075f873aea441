"""The detector, and a view for eyes.

blur       of focal spot, panel and quantum noise, in frequency
panel      quantum and readout noise, gain, offset, 16 bit
rendering  log signal, bone bright
"""

from .rendering import present

__all__ = ["present"]
