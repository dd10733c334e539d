"""Relative alpha from a stiffness matrix alone, in the order of the data.

couplings           couplings between actuators, and the positions that they imply
facts               properties of a matrix, each computed once
order               whether it is a stiffness, its orientation, and the order of its coordinates
misfits             actuators and sensors that do not fit the others
screen              the matrix without them
columns             likelihood of the columns, each with the noise that its data show
modes               relative alpha from columns or elastic modes
coherent_imbalance  whether the remaining imbalance is noise or the pattern of a mistake
"""
