"""Studies: statistics of the estimators against known truth."""
