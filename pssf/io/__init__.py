"""Input and output: read and write all files except the data tables of the package, which `data` reads.

atomic_write        write a file completely or not at all
metadata            the JSON metadata of a radiograph, and the hashes over metadata and pixels
radiograph_files    radiographs as TIFF, DICOM, PNG and JSON
mask_files          masks as TIFF and DICOM
label_formats       landmarks as .pts and COCO files
image_kind          recognise image files by suffix or first bytes
csv_rows            rows of CSV files
cohort_records      specification, records and manifest of a cohort
study_results       tables, JSON, figures and pages of a study
file_conditions     check conditions on the content of result files
run_record          command, date and machine of a run
pictures            small pictures for display on a screen
to_bytes            radiographs and meshes as bytes
dicom               DICOM Digital X-Ray and Segmentation objects
meshes              scenes and meshes as STL, PLY, OBJ, GLB and 3MF; a 3D viewer page
patients            patient radiographs: lists of files, stored pixels, images as displayed
"""
