"""Bench effects beyond the model: named if the data contain them, corrected if the fit then holds.

derivative    a fit, and the derivative, score and information of an effect
fields        effects on readings, summed over blocks of actuators
catalogue     the effects
score_test    tests of their significance
examination   which effects are named, which are taken out, and what is left
undetectable  effects that two loads cannot show, and their influence on the common scale
"""
