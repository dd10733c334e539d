"""A stiffness matrix alone.

couplings           between actuators, and the positions that they imply
facts               symmetry and negative modes
order               whether it is a stiffness, lies the right way round, in the order of places
bad_sensors         sensors that read something else
misfits             actuators that do not fit, found and set free
screen              the matrix without them
modes               relative alpha by its singular vectors
columns             the columns in balance, each with the noise that it shows
column_noise        what that noise follows
ml                  maximum likelihood
coherent_imbalance  whether the imbalance is noise, or the pattern of a mistake
"""
