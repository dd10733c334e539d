"""FITS, HDF5 and TOML on disk, whatever they mean; outputs that are complete or not there.

format       what a file of some kind holds, declared once for writing and reading
fits         FITS in and out, safely: the only importer of astropy.io.fits
hdf5         HDF5 in and out, under the names of the FITS contract
content      what a FITS file held, asked for by what a format declares
opening      files that are opened for reading: plain ones, their sizes and checksums verified
stored_rows  rows of a table that stay in their file, for campaigns larger than memory
outputs      outputs written beside their target, then renamed
toml         TOML tables, held against the dataclass that they fill
"""
