"""Importing files of other software: a matrix and positions become a checked stiffness file.

stored      the numbers in a file of any format
selection   the matrix and the positions among its arrays, and their units
export      a matrix times alpha, as its file stored it; folders of a supervisor and of opticalib
inputs      the input of an import: matrix, positions, date
campaign    a campaign of cycles, described by a TOML file
importing   from the input to a stiffness matrix: sign, orientation, order, actuators that are off
"""
