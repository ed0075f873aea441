"""Validation of ray casting: exact phantoms, agreement of engines, tessellation error, comparison with gVirtualXray."""
