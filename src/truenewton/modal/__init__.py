"""Stiffness modes, turbulence and dissipation: the modal base."""
