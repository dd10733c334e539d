"""The elastic shell between its actuators.

shell_model       forces that hold a mirror's shell, influence functions, stiffness, moving mass
round_shell       thin annular shell: Fourier series in angle, p-elements in radius
radial_elements   its elastic energy, harmonic by harmonic
kernels           a point force on an infinite shallow sphere, and means over circles
mesh              polygons around a glass of any outline, and triangles over it
meshed_shell      shells of any outline by finite elements; an independent check of rings
"""
