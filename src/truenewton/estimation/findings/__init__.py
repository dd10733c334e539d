"""What was found in data and results, and what every method returns.

code       the codes of findings, what each is about, the levels of a result and their thresholds
catalogue  for each code its level, sentence and remedy
finding    the record of one finding, and the verdict on all
estimate   the estimate, how well the data fit, and the budget of the common scale
"""
