"""The elastic shell between its actuators.

shell_model           a mirror's glass between its actuators, and what holds it under its loads
puck_motion          where forces act, for what annular sensors read
moving_mass          static shapes between actuators, and the mass that moves with them
air_film             damping by the film of air behind the glass
condensation         from influence to stiffness: the shell seen from its actuators alone
fourier              thin annular shell: Fourier in angle, p-elements in radius
radial_elements      its elastic energy, harmonic by harmonic
kernels              a point force on an endless shallow sphere, and means over circles
places               where forces and sensors may stand, and how many harmonics they take
loaded_edges         its edges under forces, prepared once, and what they add where it is read
finite_elements/     any outline, sharing nothing but the last step: for rings the check
"""
