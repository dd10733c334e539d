"""Reciprocity: alpha, sensor gains and sensor offsets from a stiffness that must be symmetric.

A true stiffness is symmetric (Maxwell, Betti), its forces balance, and rigid motions cost none. For
a measured stiffness K_c, force command per reading,

    D_alpha K_c = K H D_g,    K = K',    K R = 0

where H maps displacements at the sensors to those at the magnets. The most likely K is eliminated;
see docs/reciprocity.md. The files, in the order of the data:

    sensor_model  the unknowns (alpha, gains, offsets), and H
    information   the equations, their score and information, as sums of Hadamard products
    iteration     steps to the maximum of the likelihood, spreads of gains and offsets
    regression    the stiffness that a campaign measured, without actuators that do not obey it
    acceptance    whether reciprocity holds, and the estimated sensors
    noise         noise of a matrix, from its residuals, and the errors that it causes
    campaign      a campaign: relative alpha by reciprocity, the scale from the weights
    matrix        a stiffness matrix alone, with held-out modes
"""
