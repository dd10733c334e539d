"""How forces balance (eq. 1): positions of the actuators, loads, arms and signs.

layout  positions and directions of the actuators, their rings or segments
load    the added weight and the tilt of the mirror
arms    the arms A and the external load k of A f + k = 0; the only place that defines the signs
modes   eigenmodes of a stiffness matrix
"""
