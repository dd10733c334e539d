"""The result of a campaign, predicted before it is measured.

forces           forces, stroke and gap of a plan
prediction       errors of alpha and of the sensors from noiseless forces
plan_prediction  errors and time of a plan, changes that reach a target
figures          error against cycles and added weight
summary          text for the terminal, values for scripts
"""
