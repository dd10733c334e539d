"""The simulated bench, which keeps its truth to itself.

bench      the bench behind the same door as hardware
static     a mirror's truth and its campaigns, every shape held exactly or in a loop
segmented  a bench for each segment of a mirror, moved together
record     a shape in closed loop: means over the samples of a record
loop       sensors, control, DAC, coils and glass, from sample to sample
noise      random numbers of the rows
plant      the glass as the loop moves it: M z'' + C z' + K z = f
sensors    capacitive sensors
coils      coils and magnets
control    what runs in the electronics of each actuator
stability  whether gains hold the loop
truth      what a simulation knows; written beside the campaign, for scoring only
"""
