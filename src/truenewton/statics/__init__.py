"""How forces balance (eq. 1): where actuators stand, what hangs on them, their arms and signs.

layout  the actuators: positions, directions, which take part
groups  rings or segments, by which people see them
load    what hangs on the mirror, and how it leans
arms    the arms A and the external load k of A f + k = 0; the only place that knows the signs
modes   eigenmodes of a stiffness matrix
"""
