"""Rows and files that are not what they should be, before the fit.

hypotheses  files whose unit, signs, columns, labels, load or readings are not theirs
screen      rows that differ from their repeats, and frozen sensors
"""
