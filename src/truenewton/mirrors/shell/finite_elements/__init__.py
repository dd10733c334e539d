"""Thin free glass of any outline and spherical curvature, by finite elements.

meshed_shell  a free glass on a mesh under forces
energy        elastic energy on a mesh
argyris       Argyris' triangle, and quadrature
mesh          triangles over a glass
meshing       a mesh with a vertex at every actuator
outline       polygons around a glass
film          pressures in the film of air under it
"""
