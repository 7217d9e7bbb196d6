"""The blind benchmark: effects hidden in simulated data, to be named by a diagnosis.

Read in this order: :mod:`bases` (models and experiments), :mod:`cells` (which effect, how long, how
strong), :mod:`outside` (what the catalogue does not hold), :mod:`sizes` (from a likelihood ratio to a
size), :mod:`runs` (one series, one row), :mod:`figures` (what is made of the rows), :mod:`report`.
"""
