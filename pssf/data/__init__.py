"""The package's tables, and their typed, frozen records, read once.

tables   the TOML files, and protocols by name or path
anatomy  all that bones are built from, as one record
store    what takes seconds to make, kept in the user's cache folder
code     which code and tables of the package something was made by

A record is resolved at the door and passed on; no formula reads a table. Doors are what is called from outside: the
verbs that users call (`build`, `draw_knee`, `present`, `locate`, ...), the records that they construct, as they are
made, what reads or writes a whole file, the beginnings of a cohort, of a study and of each measurement of the package,
and `xray.technique_of`, where the names in a protocol become the records that all stages carry. All else is given what
it needs as arguments. The doors are listed in `tests/test_house.py`, which lets no other function call a reader.
"""
