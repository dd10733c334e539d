"""Whether a campaign is what it claims to be, before the fit, and where nothing balances after it.

column_order  the columns of FORCE and POSITION
inputs        all that may not be what it says; readings that are stuck, coils without force
campaign      what is weak in a campaign and its fit
"""
