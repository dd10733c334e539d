"""The report as one page that opens in any browser without network.

page            the page itself
section         what it is made of
sections        the sections of a calibration and its evidence
modal_sections  the sections of the modal base
views           map and rings of the actuators, which share one selection
actuator_plots  their figures, of Bokeh
"""
