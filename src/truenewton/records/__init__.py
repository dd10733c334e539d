"""What was measured: frozen records that check themselves, and their files (docs/files.md).

cycle             one run through all shapes under one load
campaign          cycles of one mirror that belong together
stiffness_matrix  a measured stiffness: commanded force per displacement
segmented         what was measured of a mirror in several segments
segment           what a segment of a mirror weighs
result            what every result can do; the columns of one, and the file of several segments
parts             what was found of each segment, or why nothing
source            the file that data came from, and what of it went into a result
samples           streams of raw samples, averaged to rows
file              cycle and stiffness files: what they hold, both ways
reader            files of cycles as they are opened, here or by a worker of a cluster
"""
