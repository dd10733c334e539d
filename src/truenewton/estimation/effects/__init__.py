"""Bench effects beyond the model: named if the data contain them, corrected if the fit then holds.

derivative    a fit, and the derivative, score, information and score test of an effect
fields        effects on readings, summed over blocks of actuators
catalogue     the effects
correction    which are significant, and how an effect is taken out
examination   which effects are named, which are taken out, and what the data cannot show
"""
