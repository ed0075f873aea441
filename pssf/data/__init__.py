"""Tables of the package, read once as typed, frozen records.

data_files     TOML tables and protocols, by name or path
user_files     safe reading of files named by the user
table_records  conversion of a table to a typed record
array_cache    computed arrays, shipped with the package or stored in the user's cache folder
code_hash      hashes of code and tables, which identify the version that made a result
knees          fields of knees and protocols, grade tables, grading, progression, cohort presets
anatomy        template anatomy, shape model, soft tissue, trabecular bone, tissues, limb sizes
imaging        detectors, scatter kernel, display processing, acquisition variability, DICOM
analysis       reference values, localisation, landmarks, reporting guidelines, benchmark

Tables are read only in entry points, which pass the records on as arguments. Functions that compute formulas read no
table. Entry points are the public functions (`pssf.__all__`), the commands, the construction of input objects, and
functions that read or write whole files. The starting functions of a cohort, a study and each measurement are entry
points too. ``tests/test_house.py`` lists the entry points that are not public, and checks that no other function calls
a reader.
"""
