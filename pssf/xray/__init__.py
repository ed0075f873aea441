"""X-ray beam and its attenuation: spectrum, materials, collimator and primary signal.

spectrum             tube and filter: photons per energy, and the response of the detector
spectrum_quadrature  reduction of a spectrum to a few energies
materials            attenuation of tissues, metals and compounds
alloys               formulas that are probably the name of an alloy by mass
collimator           irradiated field and penumbra
resolved_technique   protocol with its detector, scatter kernel and tissues
primary_beam         primary signal by the Beer-Lambert law
"""
