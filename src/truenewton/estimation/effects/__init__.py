"""What a bench does beside the model: named where data show it, taken out where that cures them.

fitted            a fit, and what the score of an effect needs of it
derivative        what an effect is: its derivative, score and information
readings          what effects on readings do
narrowed          the same of single actuators, or about the mean
catalogue         the effects
score_test        is one there?
shared_noise      the same beside noise that the readings of a row share
exchanges         columns of FORCE that stand for other actuators
correction        taken out of the data, its size estimated with alpha
unknown_force     a force that comes and goes at one actuator
examination       a fit examined: what is named, and what is taken out
examined          what is left of it then, and how well that fits
unsure_positions  magnets whose positions have a declared uncertainty
unseen            what two loads cannot show, and what it would do to the common scale
misfit            what is left unexplained, and what differs between loads
"""
