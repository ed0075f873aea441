"""Load the tables of the package once, as typed and frozen records.

data_files     TOML tables and protocols, by name or path
user_files     safe reading of files that the user specifies
table_records  conversion of a table to a typed record
array_cache    computed arrays, shipped with the package or stored in the user's cache folder
code_hash      hashes of code and tables, which identify the version that made a result
knees          fields of knees and protocols, grade tables, grading, progression, cohort presets
anatomy        template anatomy, shape model, soft tissue, trabecular bone, tissues, limb sizes
imaging        detectors, scatter kernel, display processing, acquisition variability, DICOM
analysis       reference values, localisation, landmarks, reporting guidelines, benchmark

Only entry points read tables, and pass the records to other functions as arguments. Functions that evaluate formulas
read no tables. Entry points are the public functions (`pssf.__all__`), the commands, the construction of input objects,
and functions that read or write whole files. Functions that start a cohort, a study or a measurement are also entry
points. ``tests/test_house.py`` lists the entry points that are not public, and checks that no other function calls a
reader.
"""
