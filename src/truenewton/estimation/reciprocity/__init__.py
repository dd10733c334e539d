"""Reciprocity: alpha, sensor gains and sensor offsets from a stiffness that must be symmetric.

True stiffness is symmetric (Maxwell, Betti), its forces balance, and rigid motions cost none. Of a
measured stiffness K_c, force command per reading,

    D_alpha K_c = K H D_g,    K = K',    K R = 0

with H from displacements at the sensors to those at the magnets. The likeliest K is eliminated; see
docs/reciprocity.md. The files, in the order in which data pass through them:

    unknowns       alpha, gains and offsets; which of them are asked for
    sight          H: where the sensors see the mirror, and where forces do work
    states         reading patterns, their forces and displacements, and their duals
    blocks         the three blocks of equations, their residuals and the likeliest forces
    information    score and information, as sums of Hadamard products
    known_noise    states of a regressed stiffness whose noise is known
    binned_noise   noise from what is left, in bins of modes
    element_noise  noise of single elements of a matrix, from what is left of their pairs
    response       how fits answer to it: errors that hold whatever the weights
    iteration      steps, spreads of gains and offsets, and the end
    regression     the stiffness that a campaign measured, and the noise that it leaves
    condensation   actuators and sensors that do not obey it: found, and left free
    gate           whether reciprocity holds: what speaks against it
    sensors        what it finds of the sensors
    cycles         a campaign: relative alpha by reciprocity, the scale from the weights
    matrix         a stiffness matrix alone, modes held out
"""
