"""Running a plan on any bench, so that nothing is lost and nothing goes beyond its limit.

plan        what a campaign shall be: shapes, loads, cycles, limits
shapes      the shapes of a plan, and the forces that they take
load_order  which load is put on when, for which cycles, and what drift then costs the scale
acquire     the whole: the bench of a plan, and what is missing of a campaign, cycle by cycle
taker       one shape: taken again if the reading is not sound; who looks on; Ctrl-C
checks      limits, held against every command and reading; whether a load is on
folder      a campaign's folder: for one run alone, one plan for good, and what is complete
journal     what a run writes: its log, and the shapes of the cycle under way
"""
