"""The report as one page that opens in any browser without network.

page            the page itself
section         what a section is made of
sections        the sections of a calibration and its evidence
modal_sections  the sections of the modal base
looks           fonts, colours and tools that all figures of the page share
actuator_plots  figures of actuators, which share one selection
evidence_plots  figures of rows, modes and times
modal_plots     figures of the modal base
"""
