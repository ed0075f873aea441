"""Define knees, protocols and radiographs with their labels, and sample knees and acquisitions.

knee               Knee, Osteophyte and Cyst: the parameters of one knee, checked when they are constructed
kellgren_lawrence  the Kellgren-Lawrence (KL) grade derived from an anatomy, and the grades that an anatomy allows
oarsi_grades       OARSI grades of a knee
limb_axes          limb angles and length ratios, with the definitions used on radiographs
progression        a knee at a follow-up visit, and the true change between two visits
protocol           Protocol: exposure technique, geometry, detector and simulation stages
detector           Detector: scintillator, blur, noise and readout
field_listing      lists of the Knee and Protocol fields, and changes of fields by name
radiograph         Radiograph and Truth: pixels and labels
sampling           random knees of a specified KL grade, random acquisitions, random display processing
"""
