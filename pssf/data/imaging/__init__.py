"""Tables of image formation and display: detectors, scatter, display processing, acquisition variability, DICOM."""
