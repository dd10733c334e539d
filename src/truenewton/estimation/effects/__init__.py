"""Bench effects beyond the model: named if the data contain them, corrected if the fit then holds.

derivative    a fit, and the derivative, score, information and score test of an effect
fields        effects on readings, summed over blocks of actuators
catalogue     the effects, and which of them are significant
joint         the fit of all effects together with alpha, and which of them are free
correction    unknown forces, and the errors of effects that the data cannot show
examination   which effects are named, and which are taken out
"""
