"""Benches that take data: hardware, a server or a simulation, behind one protocol.

protocol       what acquisition asks of a bench, and which one a plan names
opticalib      a mirror after opticalib's protocol
opcua/         a bench behind an OPC UA server: client, server, keys
simulated/     the simulated bench, which keeps its truth to itself
"""
