"""The package's tables, and their typed, frozen records, read once.

tables   the TOML files, and protocols by name or path
anatomy  all that bones are built from, as one record
store    what takes seconds to make, kept in the user's cache folder
code     which code and tables of the package something was made by

A record is resolved at the door and passed on; no formula reads a table. Doors are what is called from outside: the
verbs that users call (`pssf.__all__`: `build`, `draw_knee`, `present`, ...), the commands, the records that users
construct, as they are made, what reads or writes a whole file, the beginnings of a cohort, of a study and of each
measurement of the package. There names become records, once, which are then carried: `xray.technique_of` (all stages of
the chain), `AnatomyTables` (all of a knee), `model.draw_laws`, `radiomics_tables`, `study_tables`. All else is given
what it needs as arguments. Doors that are no verb of the front page are listed in `tests/test_house.py`, which lets no
other function call a reader, and no formula call a door.
"""
