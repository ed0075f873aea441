"""Input and output types: knees, protocols, radiographs with their labels, and the sampling of knees and acquisitions.

knee               Knee, Osteophyte and Cyst: the parameters of one knee, checked when they are constructed
kellgren_lawrence  the Kellgren-Lawrence (KL) grade that follows from an anatomy, and the grades that it allows
oarsi_grades       OARSI grades of a knee
limb_axes          angles and ratios of the limb, as they are measured on radiographs
progression        the same knee some years later, and the true change between two visits
protocol           Protocol: technique, geometry, detector and the stages of the simulation
field_listing      lists of the fields of a knee and of a protocol, and changes of fields by name
radiograph         Radiograph and Truth: pixels and labels
sampling           random knees of a KL grade, random acquisitions, random display processing
"""
