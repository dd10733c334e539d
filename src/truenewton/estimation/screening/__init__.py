"""Rows and files that are not what they should be, before anything is fitted.

file_labels      files whose load, SIGN or SHAPE is not what they say
compare_files    columns of a file that differ from those of the others, and copies
frozen_readings  readings that freeze, or end at a limit
noise            noise of one reading, and whether shapes repeat over loads and signs
screen           rows far from their repeats are left out
"""
