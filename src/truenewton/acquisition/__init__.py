"""Running a plan on any bench, so that nothing is lost and nothing goes beyond its limit.

plan          what a campaign shall be: shapes, loads, cycles, limits
shapes        the shapes of a plan, and the forces that they take
mountings     the order: which load is put on when, for which cycles
drift         what drift costs the scale in each order, from statics
benches       the bench that a plan chooses
acquire       the whole: checked, locked, resumed, the mirror at rest whatever happens
run           what is missing of a campaign, mounting by mounting, cycle by cycle, shape by shape
taker         one shape: limits before and after, again where the reading is not sound
limits        what the mirror may bear, held against every command and reading
load_check    whether a load is really on
folder        a campaign's folder: for one run alone, one plan for good, and what is complete
journal       the shapes of the cycle under way, on disk before the next is commanded
run_log       one log for each run, JSON lines
progress      how far a campaign is, for whoever looks on
clock         times that only grow
interruption  Ctrl-C once and twice
"""
