"""The report as one page that opens in any browser without network.

page      the page itself
sections  what it is made of: of a calibration, its evidence, the modal base
views     map and rings of the actuators, which share one selection
"""
