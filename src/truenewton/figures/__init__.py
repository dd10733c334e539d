"""The style of all figures, maps of a mirror, and figures as files.

style    colours, sizes, fonts of a journal column
maps     rings, names and the actuators (paper, fig. 2)
layers   one quantity of all actuators, for tables and on the map (fig. 6)
writing  figures as files, and as parts of a web page
"""
