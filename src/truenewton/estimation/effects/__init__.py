"""What a bench does beside the model: named where data show it, taken out where that cures them.

derivative    a fit, and the derivative, score and information of an effect
readings      effects on readings, also of single actuators
catalogue     the effects
score_test    is one there?
correction    taken out of the data, its size estimated with alpha
examination   a fit examined: what is named, what is taken out, what is left
undetectable  what two loads cannot show, and what it would do to the common scale
"""
