"""Benches that take data: hardware or a simulation, behind one protocol.

protocol       what acquisition needs of a bench
choice         which bench a plan names, and the table from its kind to what makes it
opticalib      a mirror that follows opticalib's protocol
simulated/     the simulated bench, which does not show its truth
"""
