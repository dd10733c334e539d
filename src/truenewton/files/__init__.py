"""FITS and TOML on disk, whatever they mean; outputs that are complete or not there.

format       file formats, each declared once for writing and reading
values       keys of JSON objects, each declared once for its values and its schema
fits         reading and writing FITS: the only importer of astropy.io.fits
content      what a file contains, by name, type and unit
tables       tables of text: separators, names, columns
opening      files that are opened for reading: plain files only, texts, gzipped bytes
outputs      outputs written beside their target, then renamed
toml         TOML tables, checked against the dataclass that they fill
"""
