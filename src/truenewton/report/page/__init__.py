"""The report as one page that opens in any browser without network.

page            the page itself
section         what it is made of
sections        the sections of a calibration and its evidence
modal_sections  the sections of the modal base
actuator_plots  map and rings, which share one selection
"""
