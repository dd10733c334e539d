"""What a campaign will give before it is measured; imports from both towers.

forces           what a plan asks of the mirror: forces, stroke, gap
plan_prediction  errors, time, and what would change them
third_load       what a third load would show
changes          what to change for a wanted error
figures          error against cycles and added weight
summary          text for the terminal, values for scripts
"""
