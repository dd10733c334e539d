"""Maximum likelihood, the noise where it is (docs/likelihood.md).

objective  score, information, minimisation
minimum    what goes into the likelihood and what comes out; a population of actuators
"""
