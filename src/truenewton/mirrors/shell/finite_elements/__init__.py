"""Thin free glass of any outline and spherical curvature, by finite elements.

meshed_shell  Argyris' triangle, the elastic energy, a free glass on a mesh under forces
mesh          triangles over a glass, a vertex at every actuator
outline       polygons around a glass
"""
