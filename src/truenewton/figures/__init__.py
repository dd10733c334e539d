"""The style of all figures, maps of a mirror, and figures as files.

style    colours, sizes, fonts of a journal column
layers   one quantity of all actuators, for maps and tables
maps     the actuators (paper, fig. 2), values on the map (fig. 6)
writing  figures as files, and as parts of a web page
"""
