"""The second criterion: what the free run gets wrong, on rows that the fit has not seen."""
