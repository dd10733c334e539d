"""What a campaign will give before it is measured; imports from both towers.

forces           what a plan asks of the mirror: forces, stroke, gap
prediction       errors of alpha and of the sensors from noiseless forces
plan_prediction  errors and time of a plan, a third load, what to change for a target
figures          error against cycles and added weight
summary          text for the terminal, values for scripts
"""
