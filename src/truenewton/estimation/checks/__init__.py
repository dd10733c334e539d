"""Whether a campaign is what it claims to be, once alpha is known.

column_order    the columns of FORCE and POSITION
dead_actuators  readings that are stuck, coils without force, poles exchanged
inputs          all that may not be what it says
campaign        what is weak in a campaign and its fit
"""
