"""What a day at the bench will give, before anyone touches glass; sees both towers.

forces      what a plan asks of the mirror: forces, stroke, gap
outlook     errors, time, and what would change them
third_load  what a third load would show
target      what to change for a wanted error
figures     error against cycles and added weight
words       in words and numbers: terminal, script
"""
