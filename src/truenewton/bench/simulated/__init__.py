"""The simulated bench, which does not show its truth.

bench        the bench, with the methods of any other
static       truth and campaigns of a mirror or its segments, held exactly or in a loop
loop         electronics and closed loop, from sample to sample
truth        the true values, written beside the campaign for scoring only
"""
