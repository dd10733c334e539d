"""The report as one page that opens in any browser without network.

page   the page and its sections: calibration, evidence, modal basis, segments
views  map and rings of the actuators, with one selection
"""
