"""Running a plan on any bench: no data are lost, and no limit is exceeded.

plan        the plan: shapes, loads, cycles, limits, and the shapes it leads to
load_order  the order of the loads
folder      the folder of a campaign: lock, plan and complete cycles
taker       one shape: limits, sound readings, loads, log, Ctrl-C
acquire     the whole: the bench of a plan, and what is missing of a campaign
"""
