"""Bench effects beyond the model: named if the data contain them, corrected if the fit then holds.

derivative    a fit, and the derivatives, scores and information of effects
score_test    the test of an effect, with all else free
fields        effects on readings, summed over blocks of actuators
catalogue     the effects, and which of them are significant
joint         the fit of effects together with alpha
correction    unknown forces, and the errors of effects that the data cannot show
examination   which effects are named, and which are taken out
"""
