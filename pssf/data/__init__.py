"""Tables of the package as typed, frozen records that are read once.

data_files     TOML tables and protocols, by name or path
user_files     files that a user names, read safely
table_records  conversion of a table to a typed record
array_cache    computed arrays, shipped with the package or kept in the user's cache folder
code_hash      hashes of the code and tables that a result was made by
knees          fields of knees and protocols, grade tables, grading, progression, cohort presets
anatomy        template anatomy, shape model, soft tissue, trabecular bone, tissues, limb sizes
imaging        detectors, scatter kernel, display processing, acquisition variability, DICOM
analysis       reference values, localisation, landmarks, reporting, benchmark, tables of the READMEs

Tables are read at entry points only, and the records are passed on as arguments: no formula reads a table. Entry points
are the public functions (`pssf.__all__`), the commands, the construction of input objects, functions that read or write
whole files, and the starting functions of a cohort, a study and each measurement. ``tests/test_house.py`` lists the
entry points that are not public. It allows no other function to call a reader, and no formula to call an entry point.
"""
