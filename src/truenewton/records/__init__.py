"""Data and results: frozen records that check themselves, and their files (docs/files.md).

cycle             one run through all shapes under one load; its source and segments
campaign          cycles of one mirror that are calibrated together
stiffness_matrix  a measured stiffness: commanded force per displacement
segmented         the data of one segment of a mirror
result            what all results have in common; their columns and files
tables            positions and cycles from arrays and tables
file              cycle and stiffness files
reader            data at paths: campaigns and stiffness matrices
"""
