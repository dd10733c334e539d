"""The report: what a campaign gave, on one page that opens without network."""
