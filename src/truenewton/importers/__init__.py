"""Other people's files: a matrix and positions in many layouts become a checked stiffness file.

stored      numbers in a file of any kind that is read here
selection   which of its arrays is the matrix, which are the positions, and in which units
supervisor  folders of the LBT's supervisor, read and written with alpha in, and of opticalib
inputs      what was given, read; when it was measured
importing   from all of that to a stiffness matrix: sign, orientation, order, what is off
"""
