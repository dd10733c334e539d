"""Rows and files that are not what they should be, before anything is fitted.

hypotheses       files whose unit, signs, columns, labels, load or origin is not what they claim
frozen_readings  readings that freeze, or end at a limit
noise            noise of one reading, and whether shapes repeat over loads and signs
screen           rows far from their repeats are left out
"""
