"""Other people's files: a matrix and positions in many layouts become a checked stiffness file.

text         numbers in text files: commas, semicolons, headers; a supervisor's vectors
stored       arrays and columns in a file of any kind that is read here
choice       which of a file's arrays is the matrix, which are the positions
positions    where actuators stand: units, a curved surface
stiffness_unit  of a matrix: as told, as declared, or by its size
folders      what lies in a supervisor's or an opticalib folder
supervisor   five files of the feed-forward matrix, as the LBT's supervisor keeps them
soundness    sign, orientation, order, what is off: judged, turned, said
given        what was given, read; when it was measured
importing    from all of that to a stiffness matrix
export       a supervisor's five files with alpha in
"""
