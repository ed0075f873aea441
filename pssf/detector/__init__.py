"""The detector, and a view for eyes.

blur       of focal spot, panel and quantum noise, in frequency
panel      quantum and readout noise, gain, offset, 16 bit
looks      signal -> grey: linear, processed, film      pyramid  details of each size
marker     a letter, drawn or of lead
rendering  a view for eyes, of 8 to 16 bit, marked or not
"""

from .rendering import LOOKS, look_of, named_look, present

__all__ = ["LOOKS", "look_of", "named_look", "present"]
