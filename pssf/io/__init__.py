"""Input and output of all files, except for the data tables of the package, which `data` loads.

atomic_write        atomic writing of files, which are complete or absent
metadata            JSON metadata of a radiograph, and hashes of metadata and pixels
radiograph_files    radiographs as TIFF, DICOM, PNG and JSON
mask_files          masks as TIFF and DICOM
label_formats       landmarks as .pts files and COCO files
image_kind          identification of image files by suffix or first bytes
csv_rows            rows of CSV files
cohort_records      specification, records and manifest of a cohort
study_results       tables, JSON files, figures and HTML pages of a study
file_conditions     conditions on the content of result files
run_record          command, date and machine of a run
pictures            small pictures for screen display
to_bytes            radiographs and meshes as bytes
dicom               DICOM Digital X-Ray and Segmentation objects
meshes              scenes and meshes as STL, PLY, OBJ, GLB and 3MF, and a 3D viewer page
patients            patient radiographs: file lists, stored pixels and displayed images
"""
