"""X-ray beam and its attenuation: spectrum, materials, collimator and primary signal.

spectrum             tube and filter: photons per energy, and the detector response
spectrum_quadrature  reduction of a spectrum to a few energies
materials            attenuation of tissues, metals and compounds
alloys               warnings about formulas that are probably alloy names
collimator           irradiated field and penumbra
resolved_technique   protocol with the detector, scatter kernel and tissues from the tables
primary_beam         primary signal by the Beer-Lambert law
sampled_primary      primary signal averaged over the focal spot and the pixel area
photon_interactions  cross sections and angular distributions for the Monte Carlo simulations
photon_sampling      sampling of scattering angles, energies and directions
scintillator_response  energy that a photon deposits in a scintillator
"""
