"""What was found in data and results.

code        the codes of findings, what each is about, and the levels of a result
catalogue   for each code its level, sentence and remedy
finding     the record of one finding
thresholds  between the levels
"""
