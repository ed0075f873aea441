"""The one package that touches the disk, beside `data`, which reads the package's own tables.

atomic   a file appears whole or not at all
description  what a file says of its radiograph, and the hash over both
images   radiographs as TIFF, DICOM and PNG, and back
dicom    radiographs as Digital X-Ray objects
masks    masks as TIFF and DICOM, and back; `segmentation` is the DICOM
meshes   scenes as STL, PLY, GLB and 3MF
scenes   scenes of one's own meshes
viewer   a page to inspect a scene beside its radiograph
film_list  which files of a folder, or rows of a table, are films; image_kind tells kinds of files apart
films    films as they are displayed; stored_pixels: their grey values as they are in the file
csv_rows  rows of CSV files, each column once
records  a cohort's records and manifest
results  tables, pictures and pages of a study
"""
