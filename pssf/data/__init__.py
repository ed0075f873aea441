"""The package's tables, and their typed, frozen records, read once.

tables  the TOML files, and protocols by name or path
store   what takes seconds to make, kept in the user's cache folder
code    which code and tables of the package something was made by
"""
