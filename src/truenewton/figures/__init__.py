"""How every figure looks, the map of a mirror, and how figures are written.

style    colours, sizes, fonts of a journal column
maps     the actuators (paper, fig. 2), values on the map (fig. 6)
writing  figures as files, complete or not there, and in a web page
"""
