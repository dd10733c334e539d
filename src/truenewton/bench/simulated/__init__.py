"""The simulated bench, which keeps its truth to itself."""
