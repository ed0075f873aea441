"""The beam, and what passes.

spectrum    tube and filter -> photons by energy, and their weight in the detector
materials   attenuation of tissues, metals and compounds
quadrature  few energies instead of a whole spectrum
primary     Beer and Lambert
"""
