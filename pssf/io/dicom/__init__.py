"""DICOM objects: Digital X-Ray images and Segmentations."""
