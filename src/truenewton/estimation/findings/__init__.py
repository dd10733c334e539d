"""What was found in data and results, and what every method returns.

code          the codes of findings, what each is about, and the levels of a result
catalogue     for each code its level, sentence and remedy
finding       the record of one finding, and the verdict on all
thresholds    between the levels
estimate      the estimate, how well alpha is determined, how well the data fit
scale_budget  errors of the weights, and the budget of the common scale
"""
