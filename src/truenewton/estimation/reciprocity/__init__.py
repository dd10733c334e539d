"""Reciprocity: alpha, sensor gains and sensor offsets from a stiffness that must be symmetric.

True stiffness is symmetric (Maxwell, Betti), its forces balance, and rigid motions cost none. Of a
measured stiffness K_c, force command per reading,

    D_alpha K_c = K H D_g,    K = K',    K R = 0

with H from displacements at the sensors to those at the magnets. The likeliest K is eliminated; see
docs/reciprocity.md. The files, in the order in which data pass through them:

    unknowns      alpha, gains and offsets; which of them are asked for
    sensor_model  H: where the sensors see the mirror, and where forces do work
    states        reading patterns, their forces and displacements, and their duals
    information   the equations, their score and information, as sums of Hadamard products
    noise         noise of a matrix from what is left, in bins of modes or of single elements
    response      how fits answer to it: errors that hold whatever the weights
    iteration     steps, spreads of gains and offsets, and the end
    regression    the stiffness that a campaign measured, and the noise that it leaves
    condensation  actuators and sensors that do not obey it: found, and left free
    acceptance    whether reciprocity holds, and what it finds of the sensors
    campaign      a campaign: relative alpha by reciprocity, the scale from the weights
    matrix        a stiffness matrix alone, modes held out
    prediction    what it will state of a campaign, before a reading is taken
"""
