"""Benches that take data: hardware, a server or a simulation, behind one protocol.

protocol       what acquisition needs of a bench, and which bench a plan names
opticalib      a mirror that follows opticalib's protocol
opcua/         a bench behind an OPC UA server: client, server, keys
simulated/     the simulated bench, which does not show its truth
"""
