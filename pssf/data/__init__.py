"""The package's tables, and their typed, frozen records, read once.

tables  the TOML files, and protocols by name or path
"""
